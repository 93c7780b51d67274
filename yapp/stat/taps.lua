-- SPDX-License-Identifier: GPL-2.0-or-later
-- Statistics in tshark (-z yapp,...): taps, output, exit codes.  Wireshark's windows are
-- stat.menu's.  Wireshark's API.

local csv, check = require("yapp.stat.csv"), require("yapp.stat.check")
local events, summary = require("yapp.stat.events"), require("yapp.stat.summary")
local feed_of, menu_of = require("yapp.stat.feed"), require("yapp.stat.menu")
local options_of = require("yapp.stat.options")

local M = {}

local NEW = {
  summary = summary.new,
  compare = summary.compare,
  faults = events.new,
  events = events.new,
  csv = csv.new,
  check = check.new,
}
local FAILED = 21 -- what could not be done or told

local Stat = {}
Stat.__index = Stat

--- The statistics of one plugin.
-- plugin  { version = text, catalogue = compiled,
--           late = function() -> how many periods of its message make a gap one,
--           named = function() -> list of the sources that the user named, see message.sources,
--           problems = function() -> list of texts: what the user asked for and did not get,
--           tapped = function(): tshark's taps see a packet; a first pass of two has no taps,
--           unfinished = function() -> records of the messages that the capture ends before }
-- Stat.wanted says whether anyone wants records: ask it before making one for Stat:offer.
-- Stat.wants_parts is the same for when parts of messages came.
function M.new(plugin)
  return setmetatable({
    plugin = plugin,
    wanted = false,
    wants_parts = false,
  }, Stat)
end

--- A record of stat.tell, of the packet that is dissected.
-- visited  pinfo.visited
function Stat:offer(record, visited)
  if self.idle then
    self.idle:remove()
    self.idle = nil
  end
  self.feed:offer(record, visited)
end

-- Output ----------------------------------------------------------------------------------------

local function say(text)
  io.stderr:write("yapp: ", (text:gsub("\n", "\nyapp: ")), "\n")
end

-- Makes a folder, and those above it; returns whether it is there.
local function make_folder(path)
  for stop in (path .. "/"):gmatch("()[/\\]") do
    Dir.make(path:sub(1, stop - 1))
  end
  return Dir.exists(path)
end

-- Taps ------------------------------------------------------------------------------------------

-- A tap of the packets that a filter lets through, nil for all.
local function listen(self, filter)
  local tap = Listener.new("frame", filter)
  table.insert(self.taps, tap)
  return tap
end

-- The tap that sees every packet; and one that asks for the field which has the time to the
-- nanosecond (pinfo.abs_ts has steps of 0.24 microseconds).  Asking builds trees, so in tshark it
-- goes when it knows.
local function tap_packets(self)
  local feed = self.feed
  local tap, clock = listen(self), listen(self, "frame.time_epoch")
  local is_exact = false
  local is_waiting = not gui_enabled() -- there all packets may come again

  function clock.packet(pinfo)
    if is_exact then return end
    for _, info in ipairs { all_field_infos() } do
      if info.name == "frame.time_epoch" then
        feed:begins(info.value.secs, info.value.nsecs, pinfo.rel_ts)
        is_exact = true
      end
    end
  end

  function tap.packet(pinfo)
    if is_waiting and is_exact then
      self.plugin.tapped()
      clock:remove()
      is_waiting = false
      if feed:go_direct() then self.idle = tap end -- a tap cannot go while it is called
    end
    feed:packet(pinfo.number, pinfo.rel_ts)
  end

  function tap.reset()
    feed:reset()
    is_exact = false
  end
end

function Stat:open()
  self.feed, self.wanted, self.taps = feed_of.new(self.plugin), true, {}
  tap_packets(self)
end

function Stat:close()
  for _, tap in ipairs(self.taps) do tap:remove() end -- one that stayed would build trees for ever
  self.feed, self.wanted, self.wants_parts = nil, false, false
end

-- Functions from here on raise what is wrong.

local function tap_filter(self, filter)
  local ok, tap = pcall(listen, self, filter)
  if ok then return tap end
  local why = tostring(tap):match("is invalid %- (.*)$") or tap -- before that a place in this file
  error(("the filter %s is not one: %s"):format(filter, why), 0)
end

-- Begins a statistic.
-- context  { out, width, frames } of output.print
function Stat:begin(options, context)
  local feed, filter = self.feed, options.filter and tap_filter(self, options.filter)
  function context.clock(rel) return feed:time(rel) end
  context.json, context.make_folder = options.json, make_folder
  setmetatable(context, { __index = self.plugin })
  local statistic, problem = NEW[options.what](options, context)
  if not statistic then
    error(options.what .. ": " .. problem, 0)
  end
  if statistic.event then self.wants_parts = true end
  local entry = feed:add(statistic, filter ~= nil)
  if filter then
    function filter.packet(pinfo) feed:matched(entry, pinfo.number) end
  end
end

--- Runs a statistic over all packets, in Wireshark.
-- text     as behind -z; width: of a line
-- returns  what it says, and what is wrong, as one text; a list of the frames that stand in it
function Stat:run(text, width)
  local options = options_of.read(text, self.plugin.catalogue)
  local said, frames, problems = {}, {}, options.problems
  local function out(part) said[#said + 1] = part end
  local function run()
    self:open()
    self:begin(options, { out = out, width = width, frames = frames })
    retap_packets()
    return select(2, self.feed:finish(self.plugin.unfinished()))
  end
  if not problems[1] then
    local ok, texts = pcall(run)
    problems = ok and texts or { tostring(texts) }
    self:close()
  end
  for _, problem in ipairs(problems) do
    out(problem .. "\n")
  end
  return table.concat(said), frames
end

-- tshark ----------------------------------------------------------------------------------------

-- All is seen: prints, says what is wrong, ends with a code where one is due.
function Stat:conclude()
  local ok, code, texts = pcall(self.feed.finish, self.feed, self.plugin.unfinished())
  if not ok then
    code, texts = FAILED, { tostring(code) }
  end
  local is_flushed, problem = io.stdout:flush() -- a full disk may show only here
  problem = self.problem or not is_flushed and problem
  if problem then
    texts[#texts + 1] = "standard output: " .. problem
    if code == 0 then code = FAILED end
  end
  for _, text in ipairs(texts) do
    say(text)
  end
  -- What other statistics of this run would still print is lost: the exit code counts for more.
  if code ~= 0 then os.exit(code) end
end

-- One -z argument.
function Stat:argument(text)
  local options = options_of.read(text, self.plugin.catalogue)
  if options.problems[1] and options.what ~= "check" then -- check says them in its report, too
    error(table.concat(options.problems, "\n"), 0)
  end
  if not self.feed then
    self:open()
    local tap = Listener.new("frame") -- for the end alone: the other may go
    function tap.draw() self:conclude() end
  end
  self:begin(options, { out = function(part)
    local ok, problem = io.stdout:write(part)
    if not ok then self.problem = problem end
  end })
end

--- Registers -z yapp,... and, in Wireshark, the menus.
function Stat:register()
  local menu = gui_enabled() and menu_of.register(self)
  -- Wireshark swallows an error here, so all that can fail ends with a message and a code.
  local function run(text)
    if menu then return menu.show(text) end
    local ok, problem = pcall(self.argument, self, text)
    if not ok then
      say(tostring(problem))
      os.exit(FAILED)
    end
  end
  for _, what in ipairs(options_of.WHATS) do
    register_stat_cmd_arg("yapp," .. what, run)
  end
  register_stat_cmd_arg("yapp", run) -- the longest name that fits is called: else this one
end

return M
