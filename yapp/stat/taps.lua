-- SPDX-License-Identifier: GPL-2.0-or-later
-- Statistics in tshark (-z yapp,...): taps, output, exit codes.  Wireshark's windows are stat.menu's.  API.

local M = {}

local MODULES = {}
for _, what in ipairs { "summary", "faults", "events", "csv", "check" } do MODULES[what] = "yapp.stat." .. what end
local FAILED = 21 -- what could not be done or told

local Stat = {}
Stat.__index = Stat

--- The statistics of one plugin.
-- plugin  { version = text, decode =, columns = modules, catalogue = compiled, is_whole = whether all of it loaded,
--           late = function() -> how many periods of its message make a gap one,
--           has_source = function(name) -> whether the user gave some source this name,
--           unfinished = function() -> records of the messages that the capture ends before,
--           wants_records = function(whether records are wanted, with the names of their buses).  tshark handles -z
--           when the file is open and init has run, before the first packet; in Wireshark a statistic begins and ends;
--           tapped = function(number): tshark's taps see one of the first packets }
-- Stat.wanted says whether anyone wants messages: ask it before making a record for Stat:offer.  Stat.wants_parts says
-- whether anyone wants more than whole messages: when parts came, and the last packet.
function M.new(plugin)
  return setmetatable({ plugin = plugin, wanted = false, wants_parts = false }, Stat)
end

--- A message of the packet that is dissected, or a lost part of one.
-- record   of stat.groups
-- visited  pinfo.visited
function Stat:offer(record, visited)
  self.feed:offer(record, visited)
end

-- Output --------------------------------------------------------------------------------------------------------

local function say(text)
  io.stderr:write("yapp: ", (text:gsub("\n", "\nyapp: ")), "\n")
end

-- Ends tshark.  What other statistics of this run would still print is lost: the exit code counts for more.
local function leave(code)
  io.stdout:flush()
  os.exit(code)
end

-- Standard output, with what went wrong on it: a full disk shows only here.
local function new_output()
  local output = {}
  function output.write(text)
    local ok, problem = io.stdout:write(text)
    if not ok then output.problem = output.problem or problem end
  end
  function output.finish()
    local ok, problem = io.stdout:flush()
    if not ok then output.problem = output.problem or problem end
    return output.problem
  end
  return output
end

-- Makes a folder, and those above it.
local function make_folder(path)
  local made = ""
  for part, separator in path:gmatch("([^/\\]*)([/\\]*)") do
    made = made .. part
    if part ~= "" and not Dir.exists(made) then
      local ok = Dir.make(made)
      if not ok and not Dir.exists(made) then
        local is_file = require("yapp.stat.file").exists(made)
        return nil, made .. (is_file and ": a file, not a folder" or ": no permission, or no place for it")
      end
    end
    made = made .. separator
  end
  return true
end

-- Taps ----------------------------------------------------------------------------------------------------------

-- When the first packet was captured, to the microsecond: pinfo.abs_ts is a double with steps of 0.24 microseconds.
local function begin_roughly(feed, pinfo)
  local microseconds = math.floor(pinfo.abs_ts * 1e6 + 0.5)
  local rest = microseconds % 1000000
  feed:begins((microseconds - rest) / 1000000, rest * 1000, pinfo.rel_ts)
end

-- The tap that asks for the field which has it to the nanosecond; asking costs, so it goes when it knows.
local function tap_clock(feed)
  local clock = { tap = Listener.new("frame", "frame.time_epoch") }
  function clock.tap.packet(pinfo)
    if clock.is_exact then return end
    for _, info in ipairs { all_field_infos() } do
      if info.name == "frame.time_epoch" then
        feed:begins(info.value.secs, info.value.nsecs, pinfo.rel_ts)
        clock.is_exact = true
      end
    end
  end
  function clock.tap.reset() clock.is_exact = false end
  return clock
end

-- From tshark's first packet on all packets have their taps, in order: then messages that need not wait for them are
-- taken as they come, and the tap goes: at the next message, as none may go while it is called.
local function take_at_once(self, tap)
  local feed = self.feed
  function self.offer(_, record)
    feed:packet()
    tap:remove()
    function self.offer(_, other) feed:take(other) end
    feed:take(record)
  end
end

-- The tap that sees every packet, and the clock that it has.
local function tap_packets(self)
  local feed = self.feed
  local tap, clock = Listener.new("frame"), tap_clock(feed)
  local is_kept = gui_enabled() -- where all packets may come again
  function tap.packet(pinfo)
    if not feed.epoch then begin_roughly(feed, pinfo) end
    if clock and clock.is_exact and not is_kept then
      clock.tap:remove()
      clock = nil
      if not (self.wants_parts or feed:has_filter()) then take_at_once(self, tap) end
    end
    local number = feed.number
    if number or self.wants_parts then
      feed:packet(number and pinfo.number, pinfo.rel_ts)
    elseif feed.waiting_count > 0 then
      feed:packet()
    end
  end
  function tap.reset() feed:reset() end
  return tap, clock
end

local function tap_filter(feed, entry, filter)
  local tap = Listener.new("frame", filter)
  function tap.packet(pinfo) feed:matched(entry, pinfo.number) end
  return tap
end

-- Begins a statistic.
-- returns  its taps; nil and what is wrong
function Stat:begin(options, out)
  local plugin = self.plugin
  local statistic, problem = require(MODULES[options.what]).new(options, { out = out,
    clock = function(rel) return self.feed:time(rel) end, version = plugin.version, decode = plugin.decode,
    columns = plugin.columns, catalogue = plugin.catalogue, is_whole = plugin.is_whole, late = plugin.late,
    has_source = plugin.has_source, make_folder = make_folder })
  if not statistic then return nil, options.what .. ": " .. problem end
  self.wants_parts = self.wants_parts or not statistic.is_of_whole_messages
  local entry = self.feed:add(statistic, options.filter ~= nil)
  if not options.filter then return {} end
  local ok, tap = pcall(tap_filter, self.feed, entry, options.filter)
  if not ok then
    local why = tostring(tap):match("is invalid %- (.*)$") or tap -- before that stands a place in this file
    return nil, ("the filter %s is not one: %s"):format(options.filter, why)
  end
  return { tap }
end

function Stat:open()
  self.feed, self.wanted = require("yapp.stat.feed").new(), true
end

function Stat:finish()
  return self.feed:finish(self.plugin.unfinished())
end

--- Runs a statistic over all packets, in Wireshark, and returns what it says and what is wrong as one text.
-- text  as behind -z
function Stat:run(text)
  local options, said = require("yapp.stat.options").read(text, self.plugin.catalogue), {}
  local function out(part) said[#said + 1] = part end
  for _, problem in ipairs(options.problems) do out(problem .. "\n") end
  if #options.problems > 0 then return table.concat(said) end
  self:open()
  local taps, problem = self:begin(options, out)
  if taps then
    local tap, clock = tap_packets(self)
    taps[#taps + 1], taps[#taps + 2] = tap, clock.tap -- one that stayed would build a tree of every packet for ever
    retap_packets()
    local ok, code, texts = pcall(self.finish, self)
    for _, one in ipairs(ok and texts or { tostring(code) }) do out(one .. "\n") end
    for _, one in ipairs(taps) do one:remove() end
  else
    out(problem .. "\n")
  end
  self.feed, self.wanted, self.wants_parts = nil, false, false
  return table.concat(said)
end

-- tshark --------------------------------------------------------------------------------------------------------

-- All is seen: prints, says what is wrong, ends with a code where one is due.
local function conclude(self, output)
  local ok, code, texts = pcall(self.finish, self)
  if not ok then code, texts = FAILED, { tostring(code) } end
  local problem = output.finish()
  if problem then
    texts[#texts + 1] = "standard output: " .. problem
    if code == 0 then code = FAILED end
  end
  for _, text in ipairs(texts) do say(text) end
  if code ~= 0 then leave(code) end
end

-- One -z argument.  Wireshark swallows an error here, so all that can fail ends with a message and a code.
function Stat:argument(text)
  local options = require("yapp.stat.options").read(text, self.plugin.catalogue)
  for _, problem in ipairs(options.problems) do say(problem) end
  if #options.problems > 0 and not options.rules then leave(FAILED) end
  if not self.feed then
    self:open()
    self.output = new_output()
    tap_packets(self)
    local tap = Listener.new("frame") -- for the end alone
    function tap.draw() conclude(self, self.output) end
  end
  local taps, problem = self:begin(options, self.output.write)
  if not taps then
    say(problem)
    leave(FAILED)
  end
end

--- Registers -z yapp,... and, in Wireshark, the menus.
function Stat:register()
  local menu = gui_enabled() and require("yapp.stat.menu").register(self)
  local function run(text)
    if menu then return menu.show(text) end
    local ok, problem = pcall(self.argument, self, text)
    if not ok then
      say(tostring(problem))
      leave(FAILED)
    end
  end
  for what in pairs(MODULES) do register_stat_cmd_arg("yapp," .. what, run) end
  register_stat_cmd_arg("yapp", run) -- the longest name that fits is called: this one for what there is not
end

return M
