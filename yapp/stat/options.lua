-- SPDX-License-Identifier: GPL-2.0-or-later
-- What stands behind -z yapp,...: from the text to options.  Pure Lua, 5.2 and 5.4.

local rules = require("yapp.stat.rules")

local M = {}

M.WHATS = { "summary", "faults", "events", "csv", "check" }
local KNOWN = {}
for _, what in ipairs(M.WHATS) do KNOWN[what] = true end

-- The parts between commas; what follows "filter=" is a display filter, commas and all.
local function split(text)
  local at = text:find(",filter=", 1, true)
  local filter = at and text:sub(at + 8)
  local parts = {}
  for part in ((at and text:sub(1, at - 1) or text) .. ","):gmatch("([^,]*),") do parts[#parts + 1] = part end
  return parts, filter
end

local function complain(options, part, why)
  options.problems[#options.problems + 1] = ("%s: %s"):format(part == "" and "an empty option" or part, why)
end

local function read_csv(options, parts, catalogue)
  options.folder = parts[3]
  if not options.folder or options.folder == "" then
    return complain(options, "csv", "it is csv,FOLDER or csv,-,MESSAGE")
  end
  for i = 4, #parts do
    local part = parts[i]
    if part == "replace" or part == "all" or part == "json" then
      options[part] = true
    elseif options.folder == "-" and not options.chosen then
      for _, message in ipairs(catalogue.messages) do
        if message.name == part then options.chosen = message end
      end
      if not options.chosen then complain(options, part, "there is no such message in the catalogue") end
    else
      complain(options, part, "the options of csv are replace, all, json, filter=EXPRESSION")
    end
  end
  if options.folder ~= "-" or options.problems[1] then return end
  if not options.chosen then complain(options, "csv,-", "it is csv,-,MESSAGE") end
  if options.json then complain(options, "json", "csv,- prints a table; json is for csv,FOLDER") end
end

local NO_RULE = "no rule follows: it is for those behind it"

local function read_check(options, parts, catalogue)
  options.rules = {}
  local source, unused -- unused: "source=NAME", before a rule comes
  for i = 3, #parts do
    local part = parts[i]
    if part == "json" then
      options.json = true
    elseif part:find("^source=") then
      if unused then complain(options, unused, NO_RULE) end
      source, unused = part:match("=(.*)$"), part
      if source == "" then complain(options, part, "the name is missing") end
    elseif part:find("^junit=") then
      options.junit = part:match("=(.*)$")
      if options.junit == "" then complain(options, part, "the file is missing") end
    else
      local rule, problem = rules.read(part, catalogue, source)
      unused = nil
      if rule then options.rules[#options.rules + 1] = rule else complain(options, part, problem) end
    end
  end
  if unused then complain(options, unused, NO_RULE) end
  if #options.rules == 0 and #options.problems == 0 then
    complain(options, "check", "it needs a rule: " .. rules.NAMES)
  end
end

local function read_plain(options, parts)
  for i = 3, #parts do
    if parts[i] == "json" then
      options.json = true
    else
      complain(options, parts[i], ("the options of %s are json, filter=EXPRESSION"):format(options.what))
    end
  end
end

--- Reads the argument of -z.
-- text       "yapp,check,fault=0,motor.rate=9,filter=can.bus_id == 1, or so"
-- catalogue  compiled
-- returns    { what =, json = true or nil, filter = or nil, folder =, chosen =, replace =, all =, rules =, junit =,
--            problems = list of texts, each with the option that it is about }
function M.read(text, catalogue)
  local parts, filter = split(text)
  local options = { what = parts[2] or "", filter = filter, problems = {} }
  if parts[1] ~= "yapp" or not KNOWN[options.what] then
    complain(options, text, "it is yapp," .. table.concat(M.WHATS, " or yapp,"))
  elseif options.what == "csv" then
    read_csv(options, parts, catalogue)
  elseif options.what == "check" then
    read_check(options, parts, catalogue)
  else
    read_plain(options, parts)
  end
  if filter and not filter:find("%S") then complain(options, "filter=", "the display filter is missing") end
  return options
end

return M
