-- SPDX-License-Identifier: GPL-2.0-or-later
-- Statistics in tshark (-z yapp,...): taps, output, exit codes.  Wireshark's windows are
-- stat.windows's.  Wireshark's API.

local buses = require "yapp.stat.buses"
local command = require "yapp.capture.command_line"
local joined = require "yapp.base.joined"
local memo = require "yapp.base.memo"
local options_of = require "yapp.stat.options"
local output = require "yapp.stat.output"
local preferences = require "yapp.host.preferences"
local run_of = require "yapp.stat.run"
local socketcan = require "yapp.wire.socketcan"
local windows = require "yapp.stat.windows"

local M = {}

local HAS_SHELL = package.config:sub(1, 1) == "/"
local IS_TSHARK = not gui_enabled() -- Wireshark may revisit all packets
local MAY_GO_ON = not (IS_TSHARK or yapp_is_whole) -- a live capture; a page opens whole ones
local HINT = "-Y does not narrow a statistic, and -R may remove parts of messages: " ..
  "use filter=EXPRESSION as its last option"
local FAILED = "the plugin failed, so the answer is incomplete: %s, see the filter _ws.lua.error"
local UNREAD = "only %d of %d packets were read, as the reading was stopped, or another window " ..
  "read: press Refresh"
local GOES_ON = "only %s read: of a live capture with -b tshark analyses the first file: " ..
  "read each file with tshark -r"
local RESET = "only %d of %d packets were read, as tshark -M forgets what came before: leave it out"
local STOPPED = "only %s read, as -c, -a or stop= ended the reading"
local CUT = "the file ends early, so what came last is missing: its recorder did not close it"
local REFUSED = "this Wireshark does not dissect %s, as CAN FD without its flag FDF: use 4.4"
-- COMPAT 4.6: earlier versions dissect CAN FD without its flag.
local REFUSES_FRAMES = not get_version():find("^4%.[0-5]%.")
local UNDECODED = "%s in this file %s not decoded; try %s"
local RELOADED = "Lua plugins were reloaded while the capture was open, so not all of it is " ..
  "known: reload the capture, too (Ctrl+R)"
local BUSY = "YAPP: another window is still reading the packets: press Refresh when it is done\n"

local Stat = {}
Stat.__index = Stat

--- Make the statistics of one plugin.
-- parts  {
--   settings   read from the preferences, {
--     version       of the plugin; catalogue = compiled
--     published     lists of rows for stat.inventory, { fields, experts, preferences }
--     late          a gap of more periods is a silence
--     sources       a message.sources
--     ids           [message name] = list of the IDs that its preference has
--     problems      list of texts: wishes of the user that were not met }
--   wants = a show.wants, capture = a capture.capture
--   reading    a reading.reading, frames = a host.can, headers = a host.header
--   find_options  function() -> list of tshark's options that decode other packets, and the number
--              of headers that these have, 0 if it is not known
--   watch      function(), called when statistics begin
--   counted    function(f) -> f, whose calls are counted
--   count_failures  function() -> how many of these calls failed since the capture was opened }
-- In Wireshark it also has show = function(text), which opens the window of an argument of -z.
function M.new(parts)
  parts.total = 0 -- in Wireshark: number of packets in the capture
  return setmetatable(parts, Stat)
end

local function print_error(text)
  io.stderr:write("yapp: ", (text:gsub("\n", "\nyapp: ")), "\n")
end

-- Make a folder in one that exists; return whether it is there.
local function make_folder(path)
  Dir.make(path)
  return Dir.exists(path)
end

-- Taps ------------------------------------------------------------------------------------------

-- Tap the packets that a filter lets through, nil for all.  Return the tap.
-- call  function(pinfo, tvb), which Stat.counted wraps
local function add_tap(self, filter, call)
  local tap = Listener.new("frame", filter)
  table.insert(self.taps, tap)
  if call then tap.packet = self.counted(call) end
  return tap
end

-- Return the source of a packet's bus.
local function source_of_bus(self, number, pinfo)
  return self.bus_sources[self.capture.bus_of(number, pinfo) or false]
end

-- See the header of a packet that has no frame of YAPP, or one that waits for it: Wireshark hands
-- error frames to no dissector, and may refuse others.
local function see_header(self, number, pinfo, tvb)
  local drop, frames = self.refused, self.frames
  local packet = tvb:len() > 0 and tvb:raw() or "" -- without bytes raw() throws past Lua
  if frames.waits then frames:resume(number, packet) end
  local kind = socketcan.find_unseen(packet)
  local is_can = kind and self.capture:is_can(number, pinfo)
  if kind == "error" and is_can ~= false then
    self.current:report {
      kind = "bus_errors",
      frame = { number = number, time = pinfo.rel_ts, source = source_of_bus(self, number, pinfo) },
      reports = buses.read_error(packet),
    }
  elseif kind == "long" and is_can and REFUSES_FRAMES then
    drop.count = drop.count + 1
    drop.frame, drop.time = drop.frame or number, drop.time or pinfo.abs_ts
  end
end

-- Tap all packets: ask nothing of a packet that need not be.  tshark numbers them as they come.
local function tap_packets(self)
  local is_waiting, run = IS_TSHARK, self.current
  local capture, frames, asker = self.capture, self.frames, self.wants
  local function has_clock() return select(2, capture:has_times()) end
  local tap = add_tap(self, nil, function(pinfo, tvb)
    local number = run.packets + 1
    -- Packets that come while Wireshark revisits those of a live capture are revisited, too.
    if not IS_TSHARK and pinfo.number ~= number then return end
    if number == 1 then run.dates:set_first(capture:begin(pinfo)) end
    if is_waiting and asker.first_pass then -- known once a packet has YAPP
      is_waiting = false
      -- A tap that is called before the last packet is dissected is so in tshark's only pass.
      if not frames:is_second_pass(number) then asker:set_only_pass() end
    end
    if frames.waits or number ~= frames.number then see_header(self, number, pinfo, tvb) end
    run:packet(number, pinfo.rel_ts, has_clock)
  end)

  -- All packets will be revisited.  In Wireshark another window that wants to read while this
  -- statistic reads resets all taps, too, although Wireshark then goes on with this reading.
  function tap.reset()
    if not IS_TSHARK and run.packets > 0 then return end
    run:reset()
    frames:begin_count()
  end
end

-- Show all CAN frames to a stat.buses.
-- filter  that these pass, or nil
local function tap_frames(self, statistic, filter)
  local passes = filter and ("can.id && (%s)"):format(filter) or "can.id"
  local stamps, frames = self.capture.stamps, self.frames
  add_tap(self, passes, function(pinfo, tvb)
    local number = pinfo.number
    local time = stamps:even(pinfo.rel_ts, number)
    statistic:add_frame(source_of_bus(self, number, pinfo), time, tvb:raw(),
      frames.number == number)
  end)
end

local function open(self)
  local options = command.options()
  local hint = (options.Y or options.R) and HINT
  self.options, self.taps = options, {}
  self.current = run_of.new(self.settings, self.capture.stamps, hint)
  self.reading:listen(self.current)
  self.frames:begin_count()
  self.watch()
  self.wants.has_statistic = true
  socketcan.choose_order(get_preference("can.byte_swap"))
  -- In a first pass of two no tap sees the header of a frame of zeros.
  if options["2"] then self.headers:start() end
  self.refused = { count = 0 } -- frames that this Wireshark refuses, as of Capture:drops
  self.bus_sources = memo(function(bus) return { bus = self.capture:name(bus or nil) } end)
  tap_packets(self)
end

local function close(self)
  for _, tap in ipairs(self.taps) do tap:remove() end -- a tap that stays would build trees for ever
  self.reading:listen(false)
end

-- Return whether -c or -a may have stopped the reading of a file.
local function is_stopped(self, packets)
  local options, in_file = self.options, self.capture.found.count
  local limit = tonumber(options.c) or options.a and 0
  if not (options.r and limit) then return false end
  if in_file >= packets then return in_file > limit end -- else only its begin was looked at
  return packets >= limit or options.R -- a read filter leaves out some
end

-- Return why packets of the capture were not read, nil if all were.
local function explain_unread(self)
  local packets, unread, options = self.current.packets, self.current.unread, self.options
  if packets < self.total then return UNREAD:format(packets, self.total) end -- in Wireshark
  local count = output.were(packets, "packet")
  if options.b then return GOES_ON:format(count) end
  if unread > 0 then return RESET:format(packets, packets + unread) end
  if self.is_over or is_stopped(self, packets) then return STOPPED:format(count) end
  return self.capture:is_cut() and CUT or nil
end

-- Return that YAPP in this file was not decoded; nil if no trace of it was found.
local function explain_undecoded(self)
  local options, count = self.find_options()
  if not options[1] then return nil end
  local headers = count > 0 and output.count(count, "YAPP header") or "YAPP headers"
  return UNDECODED:format(headers, count == 1 and "was" or "were", table.concat(options, " "))
end

-- End all statistics; return the exit code, and a list of texts to say.
local function finish(self)
  local failures, unread = self.count_failures(), explain_unread(self)
  local undecoded, capture, drop = explain_undecoded(self), self.capture, self.refused
  local failed = failures > 0 and FAILED:format(output.count(failures, "Lua error"))
  local refused = drop.count > 0 and REFUSED:format(output.count(drop.count, "packet"))
  local reloaded = self.total > 0 and capture:missed_file() and RELOADED
  return self.current:finish {
    results = self.reading:finish(MAY_GO_ON),
    drops = joined(capture:drops(), self.reading:drops(), { refused and drop }),
    lacks_times = not capture:has_times(),
    extended = self.frames.refused_count,
    problems = joined(self.settings.problems,
      { failed, unread or false, reloaded, refused, undecoded }),
    unread = unread and "not all packets were read",
    is_partial = refused or undecoded,
  }
end

-- Functions from here on raise errors.

-- The terminal --------------------------------------------------------------------------------

-- Let a live statistic draw in the terminal, if there is one, and end the run.
local function add_terminal(self, options, context)
  options.json = options.json or not (HAS_SHELL and os.execute("test -t 1"))
  function context.terminal()
    local stty, wants = io.popen("stty size 2>/dev/null </dev/tty"), self.wants.first_pass
    local height, width = stty:read("*a"):match("([1-9]%d*) ([1-9]%d*)") -- "0 0" if not known
    stty:close()
    return tonumber(width) or 80, tonumber(height) or 24, wants and wants.columns
  end
  function context.flush() return io.stdout:flush() end
  -- SIGINT ends a capture, and its file is whole.  While a file is read, SIGINT ends tshark without
  -- an answer.  os.execute ignores SIGINT, io.popen does not.
  function context.stop()
    if HAS_SHELL and (self.options.i or self.capture.found.is_live) then
      io.popen("kill -INT $PPID"):close()
    else
      self.is_over = true
      self.taps[1].packet = function() self:conclude() end -- ends the reading
    end
  end
end

-- Begin the statistic of an argument of -z.
-- context  { out, frames } of output.print
local function begin_statistic(self, text, context)
  local options, run = options_of.parse(text, self.settings.catalogue), self.current
  if options.problems[1] and options.what ~= "check" then -- which names them in its report, too
    error(table.concat(options.problems, "\n"), 0)
  end
  local filter, row = options.filter, options.row
  if filter then
    local matched = {}
    options.matched = matched
    local ok, problem = pcall(add_tap, self, filter, function(pinfo)
      matched[pinfo.number] = true
    end)
    if not ok then
      local why = tostring(problem):match("is invalid %- (.*)$") or problem
      error(("the filter %s is not one: %s"):format(filter, why), 0)
    end
  end
  context.dates, context.settings, context.make_folder = run.dates, self.settings, make_folder
  if row.is_live and not context.frames then add_terminal(self, options, context) end
  context.json = options.json
  local statistic = row.new(options, context)
  if options.bitrate or row.name == "buses" then
    tap_frames(self, statistic.buses or statistic, filter)
  end
  run:add(statistic, options)
end

--- Run a statistic over all packets, in Wireshark.
-- text     as behind -z
-- returns  its output and the problems, as one text; a list of the frames in it
function Stat:run(text)
  if self.is_reading then return BUSY, {} end
  self.is_reading = true
  local said, frames = {}, {}
  open(self)
  local ok, texts = pcall(function()
    begin_statistic(self, text, {
      out = function(chunk) said[#said + 1] = chunk end,
      frames = frames,
    })
    retap_packets()
    return select(2, finish(self))
  end)
  close(self)
  self.is_reading = false
  local answer = table.concat(said)
  for _, problem in ipairs(ok and texts or { tostring(texts) }) do
    if not answer:find(problem, 1, true) then answer = answer .. problem .. "\n" end
  end
  return answer, frames
end

-- tshark ----------------------------------------------------------------------------------------

--- All packets have come: print, name errors, and exit if the code is not 0.
function Stat:conclude()
  local ok, code, texts = pcall(finish, self)
  if not ok then
    code, texts = output.EXIT_UNDECIDED, { tostring(code) }
  end
  local problem = self.problem or select(2, io.stdout:flush()) -- a full disk may show only here
  if problem then
    texts[#texts + 1] = "standard output: " .. problem
    if code == output.EXIT_OK then code = output.EXIT_UNDECIDED end
  end
  local is_said = {} -- by line
  for line in table.concat(texts, "\n"):gmatch("[^\n]+") do
    local text = line:gsub("^check: ", "")
    if not (is_said[line] or preferences.has_said(text)) then print_error(line) end
    is_said[line] = true
  end
  -- Other -z statistics of this run lose the rest of their output: the exit code matters more.
  if code ~= output.EXIT_OK then os.exit(code) end
end

--- Forget the capture file.  A live capture with -b may go on in another one, of which tshark
-- analyses no more than a few packets.
function Stat:reset()
  self.total = 0
  if IS_TSHARK and self.current and self.current.packets > 0 then self.current:stop() end
end

--- Begin the statistic of an argument of -z.
function Stat:begin(text)
  if self.show then return self.show(text) end
  -- Wireshark swallows an error here, so all that can fail ends with a message and a code.
  local ok, problem = pcall(function()
    if not self.current then
      open(self)
      self.taps[1].draw = function() self:conclude() end
    end
    begin_statistic(self, text, {
      out = function(chunk)
        self.problem = self.problem or select(2, io.stdout:write(chunk))
      end,
    })
  end)
  if not ok then
    print_error(tostring(problem))
    os.exit(output.EXIT_UNDECIDED)
  end
end

--- Register the menus of Wireshark, and count the packets of a capture there, where the user may
-- stop a statistic's reading.
function Stat:register_menus()
  local tap = Listener.new("frame")
  self.show, tap.draw = windows.register(self)
  function tap.packet(pinfo)
    self.total = math.max(self.total, pinfo.number)
  end
end

return M
