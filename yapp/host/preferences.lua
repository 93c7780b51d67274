-- SPDX-License-Identifier: GPL-2.0-or-later
-- The preferences: what they are called, what they say, and what is made of their texts.
-- Wireshark's API.

local M = {}

local FIRST_DLT, LAST_DLT = 147, 162 -- DLT_USER0 .. DLT_USER15

-- Says what is wrong where the user sees it: one dialog in Wireshark, stderr in tshark.
local function complain(texts)
  if #texts == 0 then return end
  if gui_enabled() and report_failure then
    report_failure("YAPP: " .. table.concat(texts, "\n"))
    return
  end
  for _, text in ipairs(texts) do io.stderr:write("yapp: " .. text .. "\n") end
end
M.complain = complain

local said = {}

--- Says what is wrong in the preferences, each text once: they are read again with each file.
function M.complain_once(texts)
  local new = {}
  for _, text in ipairs(texts) do
    if not said[text] then new[#new + 1] = "preferences: " .. text end
    said[text] = true
  end
  complain(new)
end

--- Gives a protocol its preferences.
-- proto  Proto; catalogue: compiled; decode: the module; max_id: the highest message ID
function M.define(proto, catalogue, decode, max_id)
  local prefs = proto.prefs
  prefs.divisor = Pref.enum("Compressed floats divide by", decode.MAPPING,
    "2^N - 6 is what the devices send. Choose 2^N - 5 only to reproduce the figures printed " ..
    "in the worked examples of the vendor's document (0.4975 A, 749.26 RPM).",
    {
      { 1, "2^N - 6 (mapping)", decode.MAPPING },
      { 2, "2^N - 5 (worked examples)", decode.WORKED_EXAMPLES },
    })
  for _, message in ipairs(catalogue.messages) do
    local title = message.title
    local about = "The IDs that carry Taurus " .. title .. ". Change it when a controller has " ..
      "other IDs than the default, or when several controllers share a bus: " ..
      "0x210,0x211,0x300-0x303."
    prefs[message.name .. "_ids"] =
      Pref.range(title .. " message IDs", ("0x%x"):format(message.id), about, max_id)
  end
  prefs.messages = Pref.string("File with your own messages", "",
    "A Lua file like taurus_fields.lua. Its messages come after those of yapp_messages.lua in " ..
    "the personal configuration folder, which needs no setting. It is read when Wireshark " ..
    "starts, from the default profile's setting: a change takes effect at the next start. For " ..
    "one run alone set the environment variable YAPP_MESSAGES.")
  prefs.sources = Pref.string("Names of sources", "",
    "What to call an ID, everywhere or on one bus, and which message it carries: " ..
    "0x210=motor:left_fore, can1/0x210=motor:right_fore, 0x212=left_tail. Several IDs have " ..
    "one name with a plus between them, can0/0x000+0x200+0x210=left; a bus alone names all of " ..
    "its IDs: can2=tail.")
  prefs.late = Pref.string("A gap is late above", "2.5",
    "So many times the message's period (Command 0.2 s, Motor Data 0.1 s, Health 0.5 s) make " ..
    "a gap worth a warning, yapp.late: at 2.5 one lost message is none.")
  prefs.all_extended = Pref.bool("All extended CAN frames are YAPP", false,
    "Switch it on for a bus that carries nothing but YAPP, to see unknown IDs, other YAPP CTL " ..
    "values and malformed frames too. By default only what is surely YAPP is taken.")
  prefs.search_all = Pref.bool("Look for YAPP in all TCP and UDP traffic", false,
    "YAPP in TCP and UDP is found by itself where a frame is among the first 64 KB of a file, " ..
    "and in live captures. Switch it on when YAPP comes later in your files; it costs about 1 " ..
    "µs for each packet that nobody else takes.")
  prefs.user_dlt = Pref.range("Link types that carry a serial stream", "",
    "147 to 162, the numbers of DLT_USER0 to DLT_USER15: set it for serial captures with such " ..
    "a link type, where the protocol's own DLT_USER table is not convenient. It takes the " ..
    "link type over from that table. Usually empty.",
    LAST_DLT)
end

--- "0x210,0x300-0x303" as a list of numbers up to max, each once.
function M.range(text, max)
  local numbers, there = {}, {}
  for part in tostring(text):gmatch("[^,%s]+") do
    local first, last = part:match("^(%w+)-(%w+)$")
    first, last = tonumber(first or part), tonumber(last or part)
    for n = first or 1, first and math.min(last or -1, max) or 0 do
      if not there[n] then numbers[#numbers + 1] = n end
      there[n] = true
    end
  end
  return numbers
end

--- How many periods make a gap late.
-- returns  number above 0 (2.5 where the text is none), and a list of what is wrong
function M.late(text)
  local late = tonumber(text)
  if late and late > 0 and late < math.huge then return late, {} end
  local problem = "a gap is late above %q periods: not a number above 0, so it stays 2.5"
  return 2.5, { problem:format(text) }
end

--- Says so where the file with the user's own messages is not the one that was read when Wireshark
-- started.
-- file  of the preference; read: the path that was read, or nil
function M.check_messages_file(file, read)
  if file == "" or file == read then return end
  M.complain_once { file .. " is read at the next start, if the default profile names it; " ..
    "for one run set the environment variable YAPP_MESSAGES to it" }
end

local taken = {} -- [encapsulation] = its dissector before, or true

--- Gives link types for users to the serial dissector, and back what was taken before.
-- text   of the preference
-- proto  of the serial dissector
-- returns  a list of what is wrong
function M.take_link_types(text, proto)
  local encapsulations = DissectorTable.get("wtap_encap")
  local wanted, others, problems = {}, {}, {}
  for _, dlt in ipairs(M.range(text, LAST_DLT)) do
    if dlt < FIRST_DLT then
      others[#others + 1] = dlt
    else
      wanted[wtap.USER0 + dlt - FIRST_DLT] = true
    end
  end
  if #others > 0 then
    local problem = ("link type %d is not a DLT_USER (147 to 162)"):format(others[1])
    if #others > 1 then problem = ("%s, nor are %d others"):format(problem, #others - 1) end
    problems[1] = problem
  end
  for encapsulation in pairs(wanted) do
    if not taken[encapsulation] then
      taken[encapsulation] = encapsulations:get_dissector(encapsulation) or true
      encapsulations:add(encapsulation, proto)
    end
  end
  for encapsulation, before in pairs(taken) do
    if not wanted[encapsulation] then
      encapsulations:remove(encapsulation, proto)
      if before ~= true then encapsulations:add(encapsulation, before) end
      taken[encapsulation] = nil
    end
  end
  return problems
end

return M
