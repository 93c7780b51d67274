-- SPDX-License-Identifier: GPL-2.0-or-later
-- YAPP for Wireshark, all modules in one file, made by tools/bundle.py: the sources are those files.
local folder = debug.getinfo(1, "S").source:match("^@(.*[/\\])") or "./"
local function chunk(name, text)
  return assert(load(text, "@" .. name))
end
local function module(name, text)
  local path = name:gsub("%.", "/") .. ".lua"
  package.preload[name] = package.preload[name] or function(...) return chunk(path, text)(...) end
end
module("yapp.base.alone", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- No module requires this one.  Wireshark runs it if the folder yapp/ is below a plugin folder,
-- where Wireshark runs every Lua file: in folders first, by name.  Each other module then fails to
-- find the modules that it requires.  So name the cause first, ahead of a thousand errors.
-- In a clone ci/clone.lua runs it still earlier.

local function say()
  local folder = debug.getinfo(1, "S").source:match("^@(.*[/\\])yapp[/\\]base[/\\]") or "./"
  io.stderr:write(("yapp: %s is a clone in a plugin folder, where Wireshark runs every file: " ..
    "move it elsewhere, and run make install or tools/install.py there\n"):format(folder))
end

if not package.loaded["yapp.base.alone"] then say() end
package.loaded["yapp.base.alone"] = true
]=])
module("yapp.base.bits", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- Bit operations on integers 0 .. 0xFFFFFFFF, whose results are such integers, too.  Pure Lua.
--
--   band(a, b)  the bits set in both
--   bor(a, b)   in at least one
--   bxor(a, b)  in exactly one
--
-- Lua 5.2 has its library bit32.  Later versions have operators, which are syntax errors in 5.2, so
-- they hide in a string.

local native = load([[
  return {
    band = function(a, b) return a & b end,
    bor = function(a, b) return a | b end,
    bxor = function(a, b) return a ~ b end,
  }
]], "=base.bits native")

return native and native() or require "bit32"
]=])
module("yapp.base.command_line", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The options of tshark's command line.  Pure Lua, 5.2 to 5.5.

local M = {}

local HAS_VALUE = {} -- the letters of tshark 4.0 to 4.6 that a value follows
for letter in ("aAbBcCdeEfFHijJkKmMNoOrRsStTuUwWXyYz"):gmatch(".") do HAS_VALUE[letter] = true end

-- Note the letters of a word such as -qYyapp.
-- returns  the letter whose value is the next word; nil if the word is complete
local function note_letters(found, letters)
  for i = 1, #letters do
    local letter = letters:sub(i, i)
    local rest = letters:sub(i + 1)
    found[letter] = HAS_VALUE[letter] and rest or ""
    if HAS_VALUE[letter] then return rest == "" and letter or nil end
  end
end

--- Return the options of a command line: their values by letter or long name, "" for none.
-- text  the words, each with a zero byte behind it, as /proc/self/cmdline has them; the first is
--       the program
function M.options(text)
  local found, open, is_program = {}, nil, true
  for word in text:gmatch("([^\0]*)\0") do
    local name, value = word:match("^%-%-([%w-]+)=?(.*)$")
    if is_program then
      is_program = false
    elseif open then
      found[open], open = word, nil
    elseif name then
      found[name] = value
    elseif word:find("^%-.") then
      open = note_letters(found, word:sub(2))
    end
  end
  return found
end

return M
]=])
module("yapp.base.frame_key", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The frame key: one number that identifies a frame, also when Wireshark revisits it.  Pure Lua.
--
-- It is the packet's number times 2^17 plus the offset of the frame's bytes in the packet, as a
-- packet may have several frames.  Keys ascend in the order of the capture.

local M = {}

local floor = math.floor

--- The factor of the packet's number in a key.
M.PACKET = 0x20000

--- Return the number of the packet of a frame key.
function M.number(key)
  return floor(key / 0x20000)
end

--- Return the index of the last number <= limit in an ascending list, 0 for none: 2 for { 3, 5, 9 }
-- and 8.
function M.last_until(numbers, limit)
  local low, high = 0, #numbers
  while low < high do
    local middle = floor((low + high + 1) / 2)
    if numbers[middle] <= limit then
      low = middle
    else
      high = middle - 1
    end
  end
  return low
end

return M
]=])
module("yapp.base.input", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- Checks of catalogues, preferences and options: conditions on values, and the texts of errors.
-- Pure Lua.

local utf8 = require "yapp.base.utf8"

local M = {}

--- The highest message ID that a catalogue or a preference may name.
M.MAX_ID = 2047

local MAX_PROBLEMS = 20 -- of a list
local MAX_TEXT = 1000 -- of a text
local MAX_NAME = 64 -- bytes

--- If a condition does not hold, raise a text, made as by string.format.  Return the condition.
function M.demand(condition, format, ...)
  if condition then return condition end
  error(format:format(...), 0)
end

local demand = M.demand

--- Return a value as errors show it: a text in quotes, at most 40 bytes of it.
function M.shown(v)
  local kind = type(v)
  if kind == "string" then return ("%q"):format(v:sub(1, 40)) end
  return (kind == "table" or kind == "function") and "a " .. kind or tostring(v)
end

-- Conditions on values --------------------------------------------------------------------------

function M.is_integer(v)
  return type(v) == "number" and v % 1 == 0
end

--- Whether it is a number that is neither NaN nor infinite.
function M.is_finite(v)
  return type(v) == "number" and v - v == 0
end

--- Whether it is a filter name, or a part of one.
function M.is_name(v)
  if type(v) ~= "string" or #v > MAX_NAME then return false end
  return v:find("^[a-z][a-z0-9_]*$") ~= nil
end

--- Whether it is a text, UTF-8 without control characters: Wireshark aborts at some others.
function M.is_text(v)
  if type(v) ~= "string" or v == "" or #v > MAX_TEXT then return false end
  return utf8.is_printable(v)
end

--- Raise that a number is not an integer from low to high.
-- what  its name in errors
function M.within(what, v, low, high)
  local is_within = M.is_integer(v) and v >= low and v <= high
  demand(is_within, "%s %s is not one of %d .. %d", what, M.shown(v), low, high)
end

-- Texts and lists -------------------------------------------------------------------------------

--- Return a text without blanks around it.  The time grows with its length alone: a pattern that
-- tries each blank as the last one needs 400,000 steps for each of 400,000 blanks.
function M.trim(text)
  local first = text:find("%S")
  return first and text:match(".*%S", first) or ""
end

--- Return the number that a decimal text has; nil for hexadecimal, nan, inf and other texts.
function M.decimal(text)
  local value = text:find("^[+-]?[%d.]+[eE]?[+-]?%d*$") and tonumber(text)
  return M.is_finite(value) and value or nil
end

--- Return the row of a list that has a name; nil, and the names that there are, if none has it.
function M.find(list, name)
  local names = {}
  for i, one in ipairs(list) do
    if one.name == name then return one end
    names[i] = one.name
  end
  return nil, table.concat(names, ", ")
end

-- Sets, rows and their options -------------------------------------------------------------------

--- The names in a text as a set: { [name] = true }.
function M.set(text)
  local names = {}
  for name in text:gmatch("%S+") do names[name] = true end
  return names
end

--- The keys of a table, sorted, as a text for a message.
function M.names(t)
  local names = {}
  for name in pairs(t) do names[#names + 1] = name end
  table.sort(names)
  return table.concat(names, ", ")
end

-- Options that are texts or tables wherever they stand.  The code that uses the others checks them.
local TEXTS = M.set("section unit help info")
local TABLES = M.set("values flags bits cases differences derived")

--- Raise errors in the options of a row, or of a message.
-- what        the owner of the options: "flag stopped", "type uint8"
-- options     { [name] = true } of the options that are allowed
-- positional  how many values without a name it has
function M.options(t, what, options, positional)
  for key, value in pairs(t) do
    local is_positional = M.is_integer(key) and key >= 1 and key <= positional
    if not (options[key] or is_positional) then
      demand(false, "unknown option %s; %s has %s", M.shown(key), what, M.names(options))
    end
    demand(not TEXTS[key] or M.is_text(value), "%s must be a text", key)
    demand(not TABLES[key] or type(value) == "table", "%s must be a table", key)
  end
end

--- Raise errors in the name, title or options of a row { name, ..., title }.
-- what      the kind of its list: "flag"; i = its index in that
-- title_index  the index of its title
-- options   see M.options
-- returns   its name in errors: "flag stopped"
function M.row(row, what, i, title_index, options)
  local number = what .. " " .. i
  demand(type(row) == "table", "%s: %s is not { name, ..., title }", number, M.shown(row))
  local name = row[1]
  demand(M.is_name(name), "%s: %s is not a filter name (a-z, 0-9, _)", number, M.shown(name))
  what = what .. " " .. name
  demand(M.is_text(row[title_index]), "%s has no title", what)
  M.options(row, what, options, title_index)
  return what
end

--- Return the first of many problems, and how many there are.
function M.few(problems)
  local few = {}
  for i = 1, math.min(#problems, MAX_PROBLEMS) do
    few[i] = problems[i]
  end
  if #problems > #few then
    few[#few] = ("and so on: %d problems in all"):format(#problems)
  end
  return few
end

return M
]=])
module("yapp.base.joined", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- Several lists as one.  Pure Lua.

--- Return a new list of the items of all these lists.
return function(...)
  local joint = {}
  for _, list in ipairs { ... } do
    for _, item in ipairs(list) do joint[#joint + 1] = item end
  end
  return joint
end
]=])
module("yapp.base.later", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- Modules that load when they are first used: most captures have no YAPP, and to compile all
-- modules takes longer than all else that the plugin adds to a start of Wireshark.  Pure Lua.
--
--   local later = require "yapp.base.later"
--   local reading_of = later "yapp.reading.reading"     loads nothing
--   reading_of.new(types, buses)                        loads it

local is_waiting = {} -- [name of a module] = true until it is loaded
local is_reported = {} -- [name of a module] = true once stderr has why it does not load

-- Load a module; return whether that worked, and the module, or why not.
local function load_module(name)
  local ok, loaded = pcall(require, name)
  if ok then
    is_waiting[name] = nil
    return true, loaded
  end
  local text = "cannot load %s: %s; install the plugin again"
  local why = text:format(name, (tostring(loaded):gsub("%s*\n%s*", " ")))
  if not is_reported[name] then io.stderr:write("yapp: ", why, "\n") end
  is_reported[name] = true
  return false, why
end

local M = {}

--- Load all modules that still wait.
-- returns  whether all of them could be loaded; stderr has why not
function M.load_all()
  local is_whole, names = true, {}
  for name in pairs(is_waiting) do names[#names + 1] = name end
  for _, name in ipairs(names) do is_whole = load_module(name) and is_whole end
  if is_whole and next(is_waiting) then return M.load_all() end -- a module may name others
  return is_whole
end

-- Return what stands for a module: the first use of it loads the module.
local function stand_in(_, name)
  local methods, module = {}, nil
  function methods.__index(_, key)
    if not module then
      local ok, loaded = load_module(name)
      if not ok then error(loaded, 0) end
      module, methods.__index = loaded, loaded
    end
    return module[key]
  end
  is_waiting[name] = true
  return setmetatable({}, methods)
end

return setmetatable(M, { __call = stand_in })
]=])
module("yapp.base.memo", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- A table that makes its missing values.  Pure Lua.

--- Make a table whose value for a key is make(key), called when the key is first asked for.
-- list  gets the values in the order in which they are made; nil for none
return function(make, list)
  return setmetatable({}, { __index = function(values, key)
    local value = make(key)
    values[key] = value
    if list then list[#list + 1] = value end
    return value
  end })
end
]=])
module("yapp.base.utf8", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- UTF-8 in bytes that may be anything.  Pure Lua, 5.2 and 5.4.

local M = {}

-- Patterns of the characters beyond ASCII, without control characters (Unicode, "Well-Formed UTF-8
-- Byte Sequences").  C stands for a continuation byte.
local CHARACTERS = {
  "\194[\160-\191]", "[\195-\223]C",
  "\224[\160-\191]C", "[\225-\236\238\239]CC", "\237[\128-\159]C",
  "\240[\144-\191]CC", "[\241-\243]CCC", "\244[\128-\143]CC",
}
for i, character in ipairs(CHARACTERS) do CHARACTERS[i] = character:gsub("C", "[\128-\191]") end

-- Characters that are invisible, or that change the text around them: Unicode's
-- Default_Ignorable_Code_Point, the separators U+2028 and U+2029, annotations; and U+FFFE, U+FFFF,
-- which XML does not allow.
local INVISIBLE = {
  "\194\173",                     -- U+00AD, soft hyphen
  "\205\143", "\216\156",         -- U+034F, U+061C
  "\225\133[\159\160]",           -- U+115F, U+1160
  "\225\158[\180\181]",           -- U+17B4, U+17B5
  "\225\160[\139-\143]",          -- U+180B to U+180F
  "\226\128[\139-\143]",          -- U+200B to U+200F
  "\226\128[\168-\174]",          -- U+2028 to U+202E
  "\226\129[\160-\175]",          -- U+2060 to U+206F
  "\227\133\164",                 -- U+3164
  "\239\184[\128-\143]",          -- U+FE00 to U+FE0F
  "\239\187\191", "\239\190\160", -- U+FEFF, U+FFA0
  "\239\191[\176-\187]",          -- U+FFF0 to U+FFFB
  "\239\191[\190\191]",           -- U+FFFE, U+FFFF
  "\240\155\178[\160-\163]",      -- U+1BCA0 to U+1BCA3
  "\240\157\133[\179-\186]",      -- U+1D173 to U+1D17A
  "\243\160",                     -- U+E0000 to U+E0FFF: tags and variations
}

-- A control character, or a byte beyond ASCII, and the continuation bytes behind it.
local UNSURE = "[%c\128-\255][\128-\191]*"

--- Return the text with a "?" for each character beyond ASCII.  Bytes that are not UTF-8 stay, as
-- do those of control characters.
function M.ascii(text)
  if not text:find("[\128-\255]") then return text end
  for _, character in ipairs(CHARACTERS) do text = text:gsub(character, "?") end
  return text
end

-- Return the printable character beyond ASCII that bytes begin with, "" for none.
local function printable_start(bytes)
  for _, character in ipairs(CHARACTERS) do
    local found = bytes:match("^" .. character)
    for _, invisible in ipairs(found and INVISIBLE or {}) do
      if found:find(invisible) then return "" end
    end
    if found then return found end
  end
  return ""
end

-- Return a control character, or a byte beyond ASCII and the continuation bytes behind it, fit to
-- be printed.
local function shown(bytes, shape)
  local character = printable_start(bytes)
  return character .. bytes:sub(#character + 1):gsub(".", function(byte)
    return (shape or "\\x%02X"):format(byte:byte())
  end)
end

--- Return the text fit to be printed, with "\xNN" for each byte of a control or invisible
-- character, and for bytes that are not UTF-8.
function M.printable(text)
  return (text:gsub(UNSURE, shown))
end

--- The same with "\xnn", as values of fields have it.
function M.value(text)
  return (text:gsub(UNSURE, function(bytes) return shown(bytes, "\\x%02x") end))
end

--- Whether the text is UTF-8 without control characters and without invisible ones.
function M.is_printable(text)
  return M.printable(text) == text
end

--- Return a name fit to be printed.  Different names stay different: a backslash that looks like
-- one of M.printable's becomes "\x5C".  The five characters a\x01 become a\x5Cx01.
function M.name(text)
  return M.printable((text:gsub("\\(x%x%x)", "\\x5C%1")))
end

return M
]=])
module("yapp.can.interleaved", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- Messages of one key that interleave, where a capture does not tell its buses apart.  Pure Lua.
--
-- A Start that comes while a message with the same key is open may supersede it, or come from
-- another bus.  From then on the frames of that key are pooled.  An End looks for the frames that,
-- with it, make up one of the open messages: its size and its CRC decide.  Each frame adds credit,
-- which limits the steps of the search.  If the pool has more bytes than its open messages can use,
-- all of them are given up.

local can_id = require "yapp.wire.can_id"
local crc = require "yapp.wire.crc"
local frame_key = require "yapp.base.frame_key"

local M = {}

local MAX_SUPERSEDED = 3 -- a message that more Starts than this superseded is given up
local MAX_WASTE = 4096   -- bytes in the pool beyond what its messages can use
local CREDIT_PER_FRAME, MAX_CREDIT = 32, 4096 -- steps of the search

local Pool = {}
Pool.__index = Pool

-- Withdraw an anomaly: a later frame has proved that nothing is wrong.
local function withdraw(anomaly)
  anomaly.is_withdrawn, anomaly.is_open = true, false
end

-- Add a Middle or End.
local function add_frame(self, frame)
  table.insert(self.frames, frame)
  table.insert(self.keys, frame.key)
  self.bytes, self.since = self.bytes + frame.length, self.since + frame.length
end

local function new_frame(key, data, length, is_end)
  return {
    key = key,
    data = data,
    length = length, -- on the bus
    is_end = is_end,
    is_taken = false, -- by a good message
    orphan = nil, -- its anomaly
  }
end

-- Open a message.
local function open_message(self, message, is_retry)
  message.chunks = nil
  table.insert(self.open, {
    message = message,
    start = self.starts, -- of the pool when it was opened
    anomaly = nil, -- what said that it is superseded: withdrawn if it turns out good
    is_retry = is_retry, -- whether its last fragment was shown as that of a broken message
    is_copy = false, -- whether a good message has the same Start
  })
end

--- Make the pool of a message that is open.
-- reassembly  a can.reassembly, which gets the anomalies
-- fields      of the CAN ids (wire.can_id)
function M.new(reassembly, message, fields)
  local self = setmetatable({
    reassembly = reassembly,
    can_id = fields,
    open = {}, -- see open_message; oldest Start first
    frames = {}, -- see new_frame: those that no good message has taken
    keys = {}, -- of the frames
    bytes = 0, -- of the frames
    since = 0, -- bytes of those that came since the newest Start
    time = 0, -- of the newest frame
    starts = 0, -- number of Starts that superseded others
    credit = MAX_CREDIT,
    reserve = 0, -- credit to leave for other messages: of 400, with 4 open, the first may use 100
  }, Pool)
  for i, data in ipairs(message.chunks) do
    add_frame(self, new_frame(message[i + 1], data, #data, false))
  end
  open_message(self, message, false)
  return self
end

--- Open the message of a Start.
function Pool:open_message(message)
  open_message(self, message, false)
  self.since = 0
end

--- Return the open messages, oldest Start first.
function Pool:messages()
  local list = {}
  for i, candidate in ipairs(self.open) do list[i] = candidate.message end
  return list
end

-- Return the index of the first frame behind a Start.
local function first_behind(self, message)
  return frame_key.last_until(self.keys, message[1]) + 1
end

-- Drop the frames that a good message has taken, and those in front of all open messages.
local function drop_frames(self)
  local frames, oldest, newest = self.frames, self.open[1], self.open[#self.open]
  local first = oldest and first_behind(self, oldest.message) or #frames + 1
  local first_of_newest = oldest and first_behind(self, newest.message)
  self.frames, self.keys, self.bytes, self.since = {}, {}, 0, 0
  for i, frame in ipairs(frames) do
    if i >= first and not frame.is_taken then
      add_frame(self, frame)
      if i < first_of_newest then self.since = 0 end
    elseif frame.orphan then
      frame.orphan.is_open = false
    end
  end
end

local function give_up(self, candidate)
  if candidate.anomaly then candidate.anomaly.is_open = false end
  if not candidate.is_retry then self.reassembly:give_up(candidate.message) end
end

-- Give up copies of good messages that came too long ago to end yet: each search would try them.
-- time  of the newest frame
local function give_up_copies(self, time)
  local open = {}
  for _, candidate in ipairs(self.open) do
    if candidate.is_copy and not self.reassembly:is_near(candidate.message.time, time) then
      give_up(self, candidate)
    else
      open[#open + 1] = candidate
    end
  end
  self.open = open
end

--- Note a Start: it supersedes the open messages; give up those that are too old.
-- anomaly  the one that notes this of the newest message, or nil
-- time     of the Start
-- returns  whether any is left
function Pool:supersede(anomaly, time)
  local open = self.open
  local newest = open[#open]
  newest.message.status = "superseded"
  if anomaly then newest.anomaly, anomaly.is_open = anomaly, true end
  self.starts = self.starts + 1
  if self.starts - open[1].start > MAX_SUPERSEDED then give_up(self, table.remove(open, 1)) end
  give_up_copies(self, time)
  drop_frames(self)
  return self.open[1] ~= nil
end

-- Search depth first over the frames from `first` on; the newest frame has to be the last taken.
-- goal     { crc = as sent, frames = those that are taken so far, padding = found }
-- returns  whether these are a complete message
local function search(self, goal, first, register, needed)
  local last, count = #self.frames, #goal.frames
  for i = first, last do
    local frame = self.frames[i]
    local data, length = frame.data, frame.length
    self.credit = self.credit - 1
    if self.credit < self.reserve then return false end
    goal.frames[count + 1] = frame
    -- What is truncated proves nothing.
    local is_complete = #data == length
    if i == last then
      goal.padding = is_complete and can_id.padding(data, length, needed)
      return goal.padding and crc.update(register, data, 1, needed) == goal.crc
    end
    if is_complete and length < needed and not frame.is_end and
      search(self, goal, i + 1, crc.update(register, data), needed - length) then
      return true
    end
    for k = #goal.frames, count + 1, -1 do goal.frames[k] = nil end
  end
end

-- The padding of the newest frame if all that came since the newest Start is its message; nil if
-- not.
local function padding_since_start(self, message)
  local last = self.frames[#self.frames]
  return can_id.padding(last.data, last.length, message.size - self.since + last.length)
end

local function frames_behind(self, message)
  local list = {}
  for i = first_behind(self, message), #self.frames do list[#list + 1] = self.frames[i] end
  return list
end

-- Return the frames since the newest Start if together they are its message.  The CRC decides;
-- where bytes are truncated, their number does.
-- register  CRC register in front of the payload
-- returns   list of frames, padding; nil where it does not
local function all_since_start(self, message, register)
  local padding = padding_since_start(self, message)
  if not padding then return nil end
  local frames = frames_behind(self, message)
  for i, frame in ipairs(frames) do
    local is_last = i == #frames
    if frame.is_end and not is_last then return nil end
    if #frame.data < frame.length then return frames, padding end
    register = crc.update(register, frame.data, 1, #frame.data - (is_last and padding or 0))
  end
  if register == message.crc then return frames, padding end
end

-- Give frames to a message.  Return its payload, which ends with the first truncated frame, and
-- whether there is such a frame.
local function assign_frames(message, frames)
  local chunks, is_truncated = {}, false
  for i = #message, 2, -1 do message[i] = nil end
  for i, frame in ipairs(frames) do
    message[i + 1] = frame.key
    if not is_truncated then chunks[i] = frame.data end
    is_truncated = is_truncated or #frame.data < frame.length
    if frame.orphan then withdraw(frame.orphan) end
  end
  return table.concat(chunks), is_truncated
end

local function have_same_start(a, b)
  return a.crc == b.crc and a.size == b.size
end

-- A recorder may hold the Start of a good message twice: it opened others, which are not lost.
local function forgive_copies(self, message)
  for _, candidate in ipairs(self.open) do
    local other = candidate.message
    if have_same_start(other, message) and self.reassembly:is_near(message.time, other.time) then
      candidate.is_copy, other.status = true, "superseded"
    end
  end
end

-- End an open message with these frames: with a status if it is known, else the CRC decides.
-- index    of its candidate
-- returns  the message
local function finish_candidate(self, index, frames, padding, status)
  local candidate = table.remove(self.open, index)
  local message = candidate.message
  message.time = self.time
  local payload, is_truncated = assign_frames(message, frames)
  if is_truncated then status = status or "truncated" end
  self.reassembly:finish(message, self.can_id, payload, padding, status)
  if message.status == "good" then -- else its frames may still be another's
    for _, frame in ipairs(frames) do frame.is_taken = true end
    if candidate.anomaly then withdraw(candidate.anomaly) end
    forgive_copies(self, message)
  end
  drop_frames(self)
  return message
end

-- End the message that an End completes: the newest with all frames that came since its Start,
-- else, oldest first, whichever fits.
-- returns  the message; nil if it completes none
local function complete(self)
  local open = self.open
  local function seed_of(message)
    return can_id.seed(self.can_id, message.size, message.reserved)
  end
  local newest = open[#open].message
  local frames, padding = all_since_start(self, newest, seed_of(newest))
  if frames then return finish_candidate(self, #open, frames, padding) end
  for i, candidate in ipairs(open) do
    local message, before = candidate.message, open[i - 1]
    -- Let each message use its share of the credit: the oldest is usually broken, and searches most
    -- frames.
    self.reserve = self.credit * (1 - 1 / (#open - i + 1))
    local goal = { crc = message.crc, frames = {}, padding = false }
    -- What does not complete a message completes no copy of it either.
    if not (before and have_same_start(before.message, message)) and
      search(self, goal, first_behind(self, message), seed_of(message), message.size) then
      return finish_candidate(self, i, goal.frames, goal.padding)
    end
  end
end

-- An End that completes no message seems to end the newest.  But the End may be of another bus.  So
-- if other messages are open, a copy of the newest stays open for later frames.
local function end_newest(self)
  local index, status = #self.open, nil
  local message = self.open[index].message
  if index > 1 then
    local copy = { status = "superseded" }
    for name, value in pairs(message) do copy[name] = value end
    open_message(self, copy, true)
  end
  local padding = padding_since_start(self, message)
  if not padding then status = self.reassembly:misfit(message, self.since) end
  finish_candidate(self, index, frames_behind(self, message), padding, status)
end

-- Whether the pool has more bytes than all open messages can use: then none of them will be good.
local function is_full(self)
  local limit = MAX_WASTE
  for _, candidate in ipairs(self.open) do limit = limit + candidate.message.size end
  return self.bytes > limit
end

--- Add a Middle or End.
-- returns  as Reassembly:add
function Pool:add_fragment(frame)
  local newest, kind = self.open[#self.open].message, "fragment"
  local is_end = frame.can_id.ctrl == can_id.END
  local pooled = new_frame(frame.key, frame.data, frame.reported, is_end)
  add_frame(self, pooled)
  self.time = frame.time
  self.credit = math.min(math.max(self.credit, 0) + CREDIT_PER_FRAME, MAX_CREDIT)
  local completed = is_end and complete(self)
  if completed then return "last", completed end
  if newest.status then
    kind, pooled.orphan = "other", self.reassembly:orphan(frame)
    pooled.orphan.is_open = true
  else
    newest[#newest + 1], newest.time = frame.key, frame.time -- as it seems
    if is_end then
      end_newest(self)
      kind = "last"
    end
  end
  if is_full(self) then
    if kind == "fragment" then self.reassembly:misfit(newest, self.bytes) end
    for _, candidate in ipairs(self.open) do give_up(self, candidate) end
    self.open = {}
    drop_frames(self)
  end
  return kind, kind ~= "other" and newest or nil
end

return M
]=])
module("yapp.can.reassembly", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- Reassembly: which CAN frames are YAPP, and which message their Start, Middle and End fragments
-- make up ("Multi-Frame CAN YAPP").  Pure Lua.
--
-- A slot is ID, CTL and Seq on one bus: usually one message at a time is open there.  A message of
-- several frames is
--   1 .. n     frame keys of its fragments (base.frame_key)
--   slot, source; time = of its latest frame
--   size, crc, reserved (nil for 0)  as its Start says.  The stored record of a good message may
--              lack its crc and its time
--   chunks     while it is open and in no pool of can.interleaved: the bytes of the fragments
--              behind the Start, none of an overrun; received = their sum; repeated = bytes of
--              chunks that equal the one before, or nil; is_truncated = true if the payload goes on
--              behind the chunks: it is truncated by the capture, or too long
--   status     nil while it is open, but "overrun" if it is too long already, and "superseded" if a
--              pool keeps it open behind a new Start; then "good", "bad" (CRC), "incomplete",
--              "overrun", "truncated" (by the capture), or "superseded" by a new Start or given up
--   payload    once its last fragment has come
--   padding    of CAN FD, nil for 0
--   received   bytes, of an incomplete or overrun message; calculated = CRC, of a bad one
--   has_fault  of a stored one, as Reassembly:keep was told

local can_id = require "yapp.wire.can_id"
local frame_key = require "yapp.base.frame_key"
local interleaved = require "yapp.can.interleaved"
local store = require "yapp.can.store"

local M = {}

local concat = table.concat

local MAX_OPEN = 1024 -- an open message costs memory until something ends it
local MAX_TRIES = 64 -- to leave out fragments that came twice
local MAX_DISTANCE = 0.02 -- seconds between a frame and its copy, as of reading.copies

local MISFIT = { -- by status
  incomplete = "The message that started in frame %d ends with %d of %d bytes",
  overrun = "The message that started in frame %d has %d bytes instead of %d",
}

local Reassembly = {}
Reassembly.__index = Reassembly

--- Make the reassembly of one capture.
-- max_open   messages that may be open at once; 1024 if left out
-- can_judge  function(time) -> whether time stamps tell what is a copy; they always do if left out
function M.new(max_open, can_judge)
  return setmetatable({
    can_judge = can_judge or function() return true end,
    max_open = max_open or MAX_OPEN,
    open = {}, -- [slot] = the message that is open there, or can.interleaved of several
    open_count = 0,
    ended = {}, -- [slot] = the good message that ended there last
    accepted = {}, -- [message ID] = true once a Start of it was accepted
    buses = {}, -- [bus, 0 for an unknown one] = true once a Start came there
    store = store.new(),
    -- Of the newest frame; false for none (COMPAT 5.2: nil makes the table anew).
    message = false,
    anomalies = false,
    keeps = true, -- whether it may be visited again
  }, Reassembly)
end

--- Note that something is wrong at the newest frame.
-- message    the one that is lost by it, or nil
-- text, ...  as for string.format
-- returns    an anomaly: { expert = name of an expert item, text, lost = key of the Start of the
--            message that is lost, or nil, is_open = whether it may still be withdrawn,
--            is_withdrawn = whether a later frame has proved that nothing is wrong; is_copy =
--            whether a recorder holds the frame twice, so nothing is lost }
function Reassembly:note(expert, message, text, ...)
  -- The others are nil until they are set: that halves the memory.
  local anomaly = { expert = expert, text = text:format(...), lost = message and message[1] }
  if not self.anomalies then self.anomalies = {} end
  table.insert(self.anomalies, anomaly)
  return anomaly
end

--- Return whether a frame came so soon before or after another one that it may be its copy.
function Reassembly:is_near(time, other_time)
  return math.abs(time - other_time) < MAX_DISTANCE and self.can_judge(time)
end

-- Return whether an End came twice: it equals that of the message that ended in its slot.
local function is_repeated_end(self, frame)
  local message = frame.can_id.ctrl == can_id.END and self.ended[frame.slot]
  if not message or not self:is_near(frame.time, message.time) then return false end
  local length = frame.reported - (message.padding or 0)
  return length > 0 and frame.data:sub(1, length) == message.payload:sub(-length)
end

--- Note that the message of a Middle or End is not known.
function Reassembly:orphan(frame)
  local name = can_id.CTRL_NAMES[frame.can_id.ctrl]
  local anomaly = self:note("fragment.orphan", nil, "%s fragment: no Start captured", name)
  anomaly.is_copy = is_repeated_end(self, frame) or nil
  return anomaly
end

--- Note that a message has more or fewer bytes than its size.
-- returns  its status
function Reassembly:misfit(message, received)
  local status = received < message.size and "incomplete" or "overrun"
  message.received = received
  self:note("fragment." .. status, message, MISFIT[status], frame_key.number(message[1]), received,
    message.size)
  return status
end

--- End a message.
-- fields   of its CAN ids (wire.can_id)
-- padding  how many of the payload's bytes are CAN FD padding; nil for none
-- status   where it is known; else the CRC decides between "good" and "bad"
function Reassembly:finish(message, fields, payload, padding, status)
  if (padding or 0) > 0 then
    message.padding, payload = padding, payload:sub(1, message.size)
  end
  message.payload, message.chunks, message.status = payload, nil, status
  if status then return end
  local calculated = can_id.crc(fields, payload, message.reserved)
  message.status = calculated == message.crc and "good" or "bad"
  -- COMPAT 5.2: only here, as to write nil under a name that has none makes the table anew.
  if message.status == "bad" then
    message.calculated = calculated
  else
    self.ended[message.slot] = message
  end
end

--- End a message that no last frame will show.  Keep a copy of what revisits of its fragments need:
-- it is a third as large.
function Reassembly:give_up(message)
  message.status, message.chunks = "superseded", nil
  if not self.keeps then return end
  local copy = { slot = message.slot, source = message.source, size = message.size,
    status = "superseded" }
  for i, key in ipairs(message) do copy[i] = key end
  self.store:keep(copy)
end

-- Slots ------------------------------------------------------------------------------------------

local function close(self, slot)
  self.open[slot], self.open_count = nil, self.open_count - 1
end

-- The messages that are open in a slot, oldest Start first.
local function open_in(self, slot)
  local open = self.open[slot]
  return open and (open.messages and open:messages() or { open }) or {}
end

-- Return the newest message of each slot, in the order of their Starts.
local function newest_messages(self)
  local list = {}
  for slot in pairs(self.open) do
    local messages = open_in(self, slot)
    list[#list + 1] = messages[#messages]
  end
  table.sort(list, function(a, b) return a[1] < b[1] end)
  return list
end

-- Give up the messages with the oldest Starts, to make room for one more.
local function make_room(self)
  local list = newest_messages(self)
  local count = #list - math.floor(self.max_open / 2)
  for i = 1, count do
    local slot = list[i].slot
    for _, message in ipairs(open_in(self, slot)) do self:give_up(message) end
    close(self, slot)
  end
  self:note("fragment.incomplete", nil,
    "%d messages are open: the oldest %d are given up", #list, count)
end

-- Return whether a Start came twice: it equals that of a message without further fragments.
local function is_repeated_start(self, message, frame)
  local sum, size = can_id.start(frame.data)
  return #message == 1 and message.crc == sum and message.size == size and
    self:is_near(frame.time, message.time)
end

-- A Start came while a message is open in its slot.  It may supersede that message, or be of
-- another bus: where no bus is known, or a converter lost the buses.  Later frames decide.
-- returns  a pool of can.interleaved if the message stays open, else nil
local function supersede(self, frame)
  local open, list = self.open[frame.slot], open_in(self, frame.slot)
  local newest, anomaly = list[#list], nil
  local chunks = newest.chunks
  if not newest.status then
    anomaly = self:note("fragment.incomplete", newest,
      "A new Start supersedes the message that started in frame %d: %d of %d bytes came",
      frame_key.number(newest[1]), chunks and chunks.received or open.since, newest.size)
    anomaly.is_copy = is_repeated_start(self, newest, frame) or nil
  end
  if open == newest then
    if chunks.is_truncated then
      self:give_up(open)
      return close(self, frame.slot)
    end
    for i = 2, self.keeps and #open or 0 do
      self.store:keep_anomalies(open[i], {})
    end
    open = interleaved.new(self, open, frame.can_id)
    self.open[frame.slot] = open
  end
  if open:supersede(anomaly, frame.time) then return open end
  close(self, frame.slot)
end

-- Starts -----------------------------------------------------------------------------------------

-- Note what is wrong with the captured bytes of a Start.
local function check_start(self, frame, size, reserved)
  local known, least, length = frame.source.size, frame.source.min_size, frame.reported
  if length ~= 8 then
    local expert = length > 8 and "size.mismatch" or "fragment.incomplete"
    self:note(expert, nil, "A Start has 8 bytes, this one has %d", length)
  end
  if not reserved then return end
  if size == 0 then
    self:note("size.mismatch", nil, "The size of the message is 0")
  elseif known and (size > known or size < least) then
    self:note("size.mismatch", nil, "The size is %d bytes, the catalogue says %d", size, known)
  end
  if reserved ~= 0 then
    self:note("reserved.nonzero", nil, "The reserved bytes are 0x%04x, not 0", reserved)
  end
end

-- Return whether a Start is YAPP's.  Unless the user says that every frame is, it must be
-- plausible.  An unknown ID needs Seq No 0, or an earlier Start that was accepted.  The Start of a
-- known ID may be truncated.
local function is_plausible(self, frame, size, reserved)
  local fields, is_known = frame.can_id, frame.source.size
  if frame.accepts_all then return true end
  if fields.ctl ~= 0 or frame.reported ~= 8 then return false end
  if not reserved then return is_known end
  if reserved ~= 0 or size <= 8 then return false end
  return is_known or fields.seq == 0 or self.accepted[fields.id]
end

local function start(self, frame)
  local sum, size, reserved = can_id.start(frame.data)
  if not is_plausible(self, frame, size, reserved) then return nil end
  local slot = frame.slot
  self.accepted[frame.can_id.id] = true
  self.buses[frame.bus or 0] = true
  local several = self.open[slot] and supersede(self, frame)
  check_start(self, frame, size, reserved)
  if not reserved or size == 0 then return "other" end
  local message = {
    frame.key, nil, nil, nil, nil, -- with room for the usual message of five frames
    slot = slot,
    source = frame.source,
    time = frame.time,
    size = size,
    crc = sum,
    reserved = reserved ~= 0 and reserved or nil,
    chunks = { nil, nil, nil, nil, received = 0 },
    status = nil,
    payload = nil,
  }
  if several then
    several:open_message(message)
    return "fragment", message
  end
  if self.open_count >= self.max_open then make_room(self) end
  self.open[slot], self.open_count = message, self.open_count + 1
  return "fragment", message
end

-- Middles and Ends -------------------------------------------------------------------------------

-- Try to end a message whose last frame came, without some of its fragments.  Of each run of equal
-- fragments the first ones stay.
-- goal      { message, chunks, frame = the last one, tries = how many are left,
--             out = { [index] = whether to leave out this chunk } }
-- first     fragment from which on to leave out
-- needed    the bytes that the last frame should have
-- returns   whether the CRC is good
local function try_without(self, goal, first, needed)
  local message, chunks, frame = goal.message, goal.chunks, goal.frame
  if first >= #chunks then -- the last chunk is that of the last frame
    goal.tries = goal.tries - 1
    local padding = can_id.padding(frame.data, frame.reported, needed)
    if not padding then return false end
    local kept = {}
    for i, chunk in ipairs(chunks) do
      if not goal.out[i] then kept[#kept + 1] = chunk end
    end
    self:finish(message, frame.can_id, concat(kept), padding)
    return message.status == "good"
  end
  local last = first
  while last + 1 < #chunks and chunks[last + 1] == chunks[first] do last = last + 1 end
  local size = math.max(#chunks[first], 1)
  for count = math.min(last - first, math.floor((frame.reported - needed) / size)), 0, -1 do
    for i = first + 1, last do goal.out[i] = i <= first + count end
    if try_without(self, goal, last + 1, needed + count * size) then return true end
    if goal.tries == 0 then return false end
  end
end

-- A frame comes twice if its sender missed the acknowledgement, or if a recorder holds it twice.
-- So a message that is too long may have such frames.  If its CRC is good without them, leave them
-- out.
-- needed   the bytes that the last frame should have if nothing is left out
-- returns  whether the CRC was good without some: then the message has ended
local function leave_out(self, message, frame, needed)
  local goal = { message = message, chunks = message.chunks, frame = frame, tries = MAX_TRIES,
    out = {} }
  if not try_without(self, goal, 1, needed) then return false end
  for index = #message - 1, 2, -1 do -- the first fragment is behind the Start
    if goal.out[index - 1] then
      local key, original = table.remove(message, index), index - 1
      while goal.out[original - 1] do original = original - 1 end
      if self.keeps then self.store:keep_duplicate(key, message[original]) end
    end
  end
  return true
end

-- End a message with its last frame.
local function finish_last(self, message, frame)
  local chunks, status = message.chunks, nil
  local needed = frame.reported + message.size - chunks.received
  local padding = can_id.padding(frame.data, frame.reported, needed)
  if chunks.is_truncated then status = "truncated" end
  if not padding then
    if chunks.repeated and not status and leave_out(self, message, frame, needed) then return end
    message.calculated, message.padding = nil, nil
    status = self:misfit(message, chunks.received)
  end
  self:finish(message, frame.can_id, concat(chunks), padding, status)
end

-- Add a Middle or End whose slot has no message, or several that interleave.
local function continue_other(self, frame, pool)
  local fields = frame.can_id
  if pool then
    local kind, message = pool:add_fragment(frame)
    if #pool:messages() == 0 then close(self, frame.slot) end
    return kind, message
  end
  if not frame.accepts_all and (fields.ctl ~= 0 or not frame.source.size) then return nil end
  self:orphan(frame)
  return "other"
end

local function continue(self, frame)
  local message = self.open[frame.slot]
  local chunks = message and message.chunks
  if not chunks then return continue_other(self, frame, message) end
  local data, reported, index = frame.data, frame.reported, #message
  local received = chunks.received + reported
  message[index + 1] = frame.key
  message.time = frame.time
  chunks.received = received
  if not chunks.is_truncated then
    if data == chunks[index - 1] then chunks.repeated = (chunks.repeated or 0) + reported end
    if #data < reported then chunks.is_truncated = true end
    chunks[index] = data
  end
  if frame.can_id.ctrl == can_id.END then
    close(self, frame.slot)
    finish_last(self, message, frame)
    return "last", message
  end
  local excess = received - message.size
  if excess > 0 and excess > (chunks.repeated or 0) then
    message.status = self:misfit(message, received)
    message.chunks = { received = received, is_truncated = true } -- its bytes are of no use
  end
  return "fragment", message
end

-- Other frames -----------------------------------------------------------------------------------

-- A message of one frame has a record of its own, with these fields alone.
local function single(_, frame)
  local data, reported, source = frame.data, frame.reported, frame.source
  local size = source.size and can_id.single_size(data, reported, source.min_size, source.size)
  if not (frame.accepts_all or size and frame.can_id.ctl == 0) then return nil end
  return "single", {
    frame.key,
    source = source,
    size = size or reported,
    status = #data == reported and "good" or "truncated",
    payload = data:sub(1, size or reported),
    padding = reported - (size or reported),
  }
end

local function undefined(self, frame)
  if not frame.accepts_all then return nil end
  self:note("can.ctrl.invalid", nil, "CAN CTRL is %d; 0 to 3 are defined", frame.can_id.ctrl)
  return "other"
end

-- By CAN CTRL: (reassembly, frame) -> kind, message.
local ADDERS = { [0] = single, start, continue, continue }
for ctrl = #ADDERS + 1, 15 do ADDERS[ctrl] = undefined end

-- What a frame is ---------------------------------------------------------------------------------

--- Add the next frame of the capture.
-- frame    see reading.records
-- returns  nil for a frame that is not YAPP's, else its kind: "single"; "fragment", of a message;
--          "last", with which its message ends; "other", which has no message, as the anomalies say
--          the message of a fragment or single frame, else nil
--          its list of anomalies, or false
function Reassembly:add(frame)
  self.anomalies, self.keeps = false, not frame.is_only_pass
  local kind, message = ADDERS[frame.can_id.ctrl](self, frame)
  if self.keeps then
    self.message = message or false
    -- It is not known yet which message an interleaved fragment belongs to, if any.
    local is_other = kind == "other" or kind == "fragment" and not message.chunks
    if self.anomalies or is_other then
      self.store:keep_anomalies(frame.key, self.anomalies or {})
    end
  end
  return kind, message, self.anomalies
end

--- Keep the message that the newest frame has ended for revisits.
-- has_fault  whether it has a fault flag set
function Reassembly:keep(message, has_fault)
  message.has_fault = has_fault
  self.store:keep(message)
end

--- Forget the newest frame: a read filter dropped its packet, so the next one has its key.
function Reassembly:forget(key)
  self.store:forget(key, self.message)
  self.message = false
end

-- Return the message in a slot that has a frame as a fragment, and the index of that; nil for none.
local function find_in(self, slot, key)
  local found, index = self.store:find(slot, key)
  if found then return found, index end
  for _, message in ipairs(open_in(self, slot)) do
    index = frame_key.last_until(message, key)
    if message[index] == key then return message, index end
  end
end

-- The same for all buses: once a read filter has dropped a packet, no bus is known on revisits.
local function find(self, frame)
  local message, index = find_in(self, frame.slot, frame.key)
  for bus in pairs(message and {} or self.buses) do
    message, index = find_in(self, can_id.slot(frame.can_id, bus), frame.key)
    if message then break end
  end
  return message, index
end

--- Say what a frame is that was added before.
-- returns  as Reassembly:add, and the index of the frame in its message; of a fragment that came
--          twice, the index of the one before
function Reassembly:recall(frame)
  local message, index = find(self, frame)
  local anomalies = self.store:anomalies_of(frame.key)
  if message then
    local is_last = message.payload and message[#message] == frame.key
    return is_last and "last" or "fragment", message, anomalies, index
  end
  local kind = anomalies and "other"
  if frame.can_id.ctrl == 0 then kind, message = single(self, frame) end
  return kind, message, anomalies
end

--- Return the messages that have neither ended nor been superseded, in the order of their Starts.
function Reassembly:unfinished()
  local list = {}
  for _, message in ipairs(newest_messages(self)) do
    if not message.status then list[#list + 1] = message end
  end
  return list
end

return M
]=])
module("yapp.can.store", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The memory of CAN frames for revisits.  Pure Lua.
--
-- A good message is packed into a string, so nothing is kept of its fragments.  Frames 7, 8 and 10
-- with offset 16 make a good message of 9 bytes:
--
--   starts[1] = 7 * 2^17 + 16
--   messages[1] = "|\3\1\2" and the payload: "!" where a fault is set; number of fragments;
--                 distances of their packets
--
-- Any other message is kept as it is.

local frame_key = require "yapp.base.frame_key"

local M = {}

local byte, sub = string.byte, string.sub
local last_until, number_of = frame_key.last_until, frame_key.number
local PACKET = frame_key.PACKET

-- [distance of two frame keys] = as a character
local CHARS = {}
for packets = 1, 255 do CHARS[packets * PACKET] = string.char(packets) end

local FAULT = byte("!")
local MAX_BEFORE = 8 -- so many messages of a slot may begin inside another one

local DUPLICATE = {
  expert = "fragment.duplicate",
  text = "Duplicate of the fragment before it: the CRC is good without it",
}

local Store = {}
Store.__index = Store

--- Make the store of one capture.
function M.new()
  return setmetatable({
    slots = {}, -- [slot] = see new_slot
    anomalies = {}, -- [frame key] = list, see can.reassembly
    originals = {}, -- [frame key of a fragment that came twice] = that of the fragment it repeats
  }, Store)
end

local function new_slot(source)
  return {
    source = source,
    starts = {}, -- frame keys, which ascend
    messages = {}, -- packed, or as they are
    latest = {}, -- the message that was found last
  }
end

-- Return the text of a message; nil for one that is not packed.
local function pack(message)
  local count, distances = CHARS[#message * PACKET], ""
  local is_usual = message.status == "good" and not (message.reserved or message.padding)
  if not (is_usual and count) then return nil end
  for i = 2, #message do
    local distance = CHARS[message[i] - message[i - 1]]
    if not distance then return nil end
    distances = distances .. distance
  end
  return (message.has_fault and "!" or "|") .. count .. distances .. message.payload
end

--- Keep a message that has ended.
function Store:keep(message)
  local slot = self.slots[message.slot]
  if not slot then
    slot = new_slot(message.source)
    self.slots[message.slot] = slot
  end
  local index = last_until(slot.starts, message[1]) + 1
  table.insert(slot.starts, index, message[1])
  table.insert(slot.messages, index, pack(message) or message)
end

--- Keep the anomalies of a frame.  If its message is not known yet, the list may be empty.
function Store:keep_anomalies(key, list)
  self.anomalies[key] = list
end

--- Note that a fragment came twice.
-- key, original  frame keys: of the second one, and of the first
function Store:keep_duplicate(key, original)
  self.originals[key] = original
end

--- Return the anomalies of a frame that still hold; nil where none were kept.
function Store:anomalies_of(key)
  if self.originals[key] then return { DUPLICATE } end
  local kept, list = self.anomalies[key], {}
  if not kept then return nil end
  for _, anomaly in ipairs(kept) do
    if not anomaly.is_withdrawn then list[#list + 1] = anomaly end
  end
  return list
end

--- Forget the newest packet: a read filter dropped it, and the next packet has its number.  Its
-- frames get keys that no frame has (key - 0.5).
-- key      of the first frame of the next packet
-- message  of the newest frame, or false
function Store:forget(key, message)
  self.anomalies[key], self.originals[key] = nil, nil
  if not message or number_of(message[#message]) ~= number_of(key) then return end
  local slot = message.payload and self.slots[message.slot]
  local index = slot and last_until(slot.starts, message[1])
  for i = #message, 1, -1 do
    if number_of(message[i]) == number_of(key) then message[i] = message[i] - 0.5 end
  end
  if not slot then return end
  slot.starts[index], slot.messages[index] = message[1], message
end

-- Return the message of a slot with this index.  A packed one has no `crc`: compute it if needed.
local function message_at(slot, index)
  local text, key = slot.messages[index], slot.starts[index]
  if type(text) == "table" then return text end
  local count = byte(text, 2)
  local payload = sub(text, count + 2)
  local message = {
    key, nil, nil, nil, nil,
    source = slot.source,
    has_fault = byte(text) == FAULT,
    status = "good",
    size = #payload,
    payload = payload,
  }
  for i = 2, count do
    key = key + byte(text, i + 1) * PACKET
    message[i] = key
  end
  return message
end

-- Return the message of a slot that has a frame as a fragment, and the index of the fragment; nil
-- for none.  A good message wins: a broken one only seemed to have the frame.
local function find_in(slot, key)
  local found, found_index = slot.latest, last_until(slot.latest, key)
  if found[found_index] == key and found.status == "good" then return found, found_index end
  local last = last_until(slot.starts, key)
  found = nil
  for i = last, math.max(last - MAX_BEFORE, 1), -1 do
    local message = message_at(slot, i)
    local index, is_good = last_until(message, key), message.status == "good"
    if message[index] == key and (is_good or not found) then
      found, found_index, slot.latest = message, index, message
      if is_good then break end
    end
  end
  return found, found_index
end

--- Return the message in a slot that has a frame as a fragment, and the index of the fragment; nil
-- for none.
function Store:find(slot, key)
  local of_slot = self.slots[slot]
  if of_slot then return find_in(of_slot, self.originals[key] or key) end
end

return M
]=])
module("yapp.file.asc", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- Vector's ASC, the text log of CANoe, CANalyzer, BUSMASTER, python-can, log2asc and loggers, as
-- packets.  Pure Lua.
--
--   date Tue Nov 14 22:13:20.001 2023
--   base hex  timestamps absolute
--   Begin Triggerblock Tue Nov 14 22:13:20.001 2023
--    0.001000 1  8408000x        Rx   d 8 FD 7F FD 7F FD 7F FD 7F
--    0.002000 CANFD   1 Rx   840C000x                          1 0 d 32 FD 7F ...
--
-- The programs differ: BUSMASTER leaves out "timestamps", others all of the head; some write "rx",
-- "D", a decimal comma, tabs.  Stamps in front of a trigger are negative.
local text = require "yapp.file.text"

local M = {}

local HEAD = 4096 -- bytes by which a file is known
local MAX_DATE = 64 -- characters
local SECOND = 1000000 -- times are in microseconds: that many are exact in every Lua
local EPOCH = 1000000000 * SECOND -- a stamp from here on is the time since 1970

local MONTHS = {}
for name, number in ([[jan 1 jän 1 feb 2 mar 3 mär 3 mrz 3 apr 4 may 5 mai 5 jun 6
  jul 7 aug 8 sep 9 oct 10 okt 10 nov 11 dec 12 dez 12]]):gmatch("(%S+) (%d+)") do
  MONTHS[name] = number
end

-- Times -------------------------------------------------------------------------------------------

local DATE = "(%S+) (%d%d?) (%d%d?):(%d%d):(%d%d)%.?(%d?%d?%d?)%d* ?([ap]?)m? (%d%d%d%d)"
local HALVES = { a = 0, p = 12 } -- of a day

-- Return a date, the recorder's local time, in microseconds since 1970; nil for another text.
--   Tue Nov 14 10:13:20.001 pm 2023
-- python-can writes 1 ms as ".1".
local function read_date(text_of_date)
  local words = text_of_date:sub(1, MAX_DATE):lower():gsub("%s+", " ")
  local date, month, milliseconds, half = {}
  month, date.day, date.hour, date.min, date.sec, milliseconds, half, date.year = words:match(DATE)
  date.month = MONTHS[month]
  if not date.month then return nil end
  if HALVES[half] then date.hour = date.hour % 12 + HALVES[half] end
  local seconds = text.seconds_of(date)
  return seconds and seconds * SECOND + ("0" .. milliseconds) * 1000
end

-- Return the time in front of a line, "-12.000123", in microseconds, and what follows; nil without.
local function read_stamp(line)
  local sign, whole, fraction, rest = line:match("^%s*(%-?)(%d+)%f[%D][.,]?(%d*)%s+(.*)$")
  if not rest or #whole > 10 then return nil end
  local time = whole * SECOND + tonumber((fraction .. "000000"):sub(1, 6))
  return sign == "-" and -time or time, rest
end

-- Return the nanoseconds, 0 to 999, that read_stamp leaves out.
local function read_rest(line)
  local digits = line:match("^%s*%d+[.,]%d%d%d%d%d%d(%d%d?%d?)%d*%s")
  return digits and tonumber((digits .. "00"):sub(1, 3)) or 0
end

-- A line ------------------------------------------------------------------------------------------

local UNKNOWN = "not an ASC line, skipped"
local ID = text.ID
local DATA = text.DATA

-- Lines without a time.
local PLAIN = {
  "^%s*$", "^%s*//", "^%s*;", "^%s*date%f[^%a]", "^%s*base%f[^%a]", "internal events logged",
  "^%s*begin trigger", "^%s*end trigger",
}
-- What follows a time in a line without a frame: of a channel, of another network, of J1939 (whose
-- frames have lines of their own), and a request to send (the frame has a line of its own).
local EVENTS = {
  "^%d+%s+statistic:", "^%d+%s+overloadframe", "^%d+%s+j1939%a*%s", "^%d+%s+%w+%s+txrq%s",
  "^canfd%s+%d+%s+txrq%s", "^canxl%s", "^can%s+%d+%s+status:", "^l%d*%s", "^li?n?%d*%s", "^eth%s",
  "^fr%w*%s", "^most%d*%s", "^j%d+%a*%s", "^sv:", "^a429%a*%s",
}
-- With one of these behind the time, a line may have been a frame.
local LIKE_FRAMES = { "^%d+%s", "^%d+$", "^canfd%f[^%a]", "%f[%a][rt]x%f[^%a]" }

local function has_one_of(lower, patterns)
  for _, pattern in ipairs(patterns) do
    if lower:find(pattern) then return true end
  end
  return false
end

-- Return why a line without a frame was not understood, nil if it is known.
-- rest  what follows its time, nil without a time
local function reason_of(line, rest)
  if not rest then return not has_one_of(line:lower(), PLAIN) and UNKNOWN or nil end
  local lower = rest:lower()
  return has_one_of(lower, LIKE_FRAMES) and not has_one_of(lower, EVENTS) and UNKNOWN or nil
end

-- Return the id in "8404000x", with SocketCAN's flag of an extended one; nil for another text.
local function read_id(id, base)
  local digits, extended = id:match("^(%x+)([xX]?)$")
  local value = digits and #digits <= 10 and tonumber(digits, base)
  if not value then return nil end
  if extended == "" then return value < 0x800 and value or nil end
  return value < 0x20000000 and value + text.EXTENDED or nil
end

local BYTE = "^%s*(%x%x?%x?)%f[%X]()"
local BYTES = {}
for _, base in ipairs { 10, 16 } do
  BYTES[base] = text.byte_table(function(digits) return tonumber(digits, base) end)
end

-- Fill in "d 8 FD 7F ...", "r 8": a length of 9 to 15 means 8.
local function read_classic(record, rest, base)
  local kind, code, data = rest:match("^([dDrR])%s*(%x?)%s*(.*)$")
  record.length = math.min(tonumber(code or "", 16) or 0, 8)
  if kind == "r" or kind == "R" then
    record.id = record.id + text.REMOTE
    record.data = ""
  elseif kind and code ~= "" then
    record.data = text.read_bytes(data, record.length, BYTE, BYTES[base])
  end
end

-- BRS, ESI, DLC, length, then data, duration, bits, flags
local FLEXIBLE = "([01])%s+([01])%s+%x%d?%s+(%d+)(.*)$"

-- Fill in a CAN FD frame, with or without a name in front.
local function read_flexible(record, rest, base)
  local brs, esi, length, data = rest:match("^" .. FLEXIBLE)
  if not brs then brs, esi, length, data = rest:match("^%S+%s+" .. FLEXIBLE) end
  record.length = tonumber(length)
  if not length or record.length > 64 then return end
  local stop
  record.data, stop = text.read_bytes(data, record.length, BYTE, BYTES[base])
  local flags = tonumber(data:match("^%s*%d+%s+%d+%s+(%x+)", stop) or "1000", 16)
  if flags % 0x2000 >= 0x1000 then
    record.fd = true
    record.flags = 4 + brs + 2 * esi -- FDF, BRS, ESI
  end
end

-- By the word in front of the channel: what reads the text behind the id; the pattern of id and
-- direction, and whether the direction is in front.
local FORMS = {
  [""] = { read = read_classic, pattern = "^(%w+)%s+([RrTt])[Xx]%s+(.*)$" },
  CANFD = { read = read_flexible, pattern = "^([RrTt])[Xx]%s+(%w+)%s+(.*)$", is_turned = true },
}

--- Read one line.
-- line     without its end
-- base     10 or 16: of the file's ids and data
-- returns  a record { bus = channel, id = with SocketCAN's flags, fd, sent, length, flags,
--          raw_dlc = 0, data }, or nil for a line that is no frame; the time in front of the line
--          in microseconds, or nil; and a reason if the line was not understood
function M.parse(line, base)
  local stamp, rest = read_stamp(line)
  if not stamp then return nil, nil, reason_of(line) end
  local kind, channel, behind = rest:match("^(%a*)%s*(%d%d?%d?)%s+(%S.*)$")
  local form = FORMS[(kind or "none"):upper()]
  if not form then return nil, stamp, reason_of(line, rest) end
  local record = { bus = tonumber(channel), flags = 0, raw_dlc = 0 }
  if behind:find("^[RrTtXx]*%s*[Ee]rror[Ff]rame") then
    record.id = text.ERROR + 0x80 -- a bus error
    record.length = 8
    record.data = ("\0"):rep(8)
    return record, stamp
  end
  local id, direction, data = behind:match(form.pattern)
  if form.is_turned then id, direction = direction, id end
  if not id then return nil, stamp, reason_of(line, rest) end
  record.id = read_id(id, base)
  if not record.id then return nil, stamp, ID end
  record.sent = direction == "T" or direction == "t"
  form.read(record, data, base)
  if not record.data then return nil, stamp, DATA end
  return record, stamp
end

-- A file ------------------------------------------------------------------------------------------

-- Patterns of lines with a date, by the field of the log that gets the date.
local DATES = {
  date = "^%s*date%f[%s\0](.*)",
  began = "^%s*[Bb]egin%s+[Tt]riggerblock%s+(%S.*)",
}
local NO_DATE = "no such date: times count from the date before, or from 0. Correct it, as in " ..
  '"Tue Nov 14 22:13:20.001 2023"'

-- Take the date of a line, if it has one.
local function take_date(log, line)
  for name, pattern in pairs(DATES) do
    local written = line:match(pattern)
    local date = written and read_date(written)
    if date then log[name] = date elseif written then log:skip(line, NO_DATE) end
  end
end

-- Take the time in front of a line: log.clock is the time of its frame.  A block of a log says when
-- it began: python-can counts from there, CANoe from the date of the file.
local function take_stamp(log, line, stamp)
  if log.began then
    local date = log.date or 0
    local is_since_date = math.abs(date + stamp - log.began) < 2 * SECOND
    log.start, log.began = is_since_date and date or log.began, nil
  end
  if log.is_relative then
    log.rest = log.rest + read_rest(line)
    stamp = log.sum + stamp + math.floor(log.rest / 1000)
    log.rest = log.rest % 1000
  end
  log.sum = stamp
  -- Without a date, times count from 0; from a whole second later if the first is below 0.
  log.start = log.start or log.date or math.max(0, math.ceil(-stamp / SECOND)) * SECOND
  log.clock = log.sum + (log.sum < EPOCH and log.start or 0)
end

-- Return the frame in a line, as text.open says.
local function read_record(log, line, offset)
  local record, stamp, why = M.parse(line, log.base)
  if not offset then return record end
  if why then log:lose(line, why) end
  if not stamp then return take_date(log, line) end
  take_stamp(log, line, stamp)
  if record then
    local number = record.bus
    log.buses[number] = log.buses[number] or { number = number, name = "CAN-" .. number }
    log.times[offset] = log.clock
  end
  return record
end

-- Read the first lines by a base.
-- returns  { base; frames = how many lines are frames; others = how many may be damaged ones or
--          another format's; has_several = whether the extended frames are of several channels;
--          stamps_differ = whether the stamps of frames do }
local function survey(lines, base)
  local found = { base = base, frames = 0, others = 0, has_several = false, stamps_differ = false }
  local channel, first
  for line in lines:gmatch("[^\r\n]+") do
    local record, stamp, why = M.parse(line, base)
    if record then
      found.frames = found.frames + 1
      first = first or stamp
      found.stamps_differ = found.stamps_differ or stamp ~= first
      local its_channel = record.id >= text.EXTENDED and record.bus or channel
      channel = channel or its_channel
      found.has_several = found.has_several or its_channel ~= channel
    elseif why then
      found.others = found.others + 1
    end
  end
  return found
end

-- Return whether lines begin as ASC does, with a date, a base, a comment or a time; and what they
-- say of the base, "hex" and "timestamps relative", or nil.
local function read_head(lines)
  local is_asc, base, rest
  for line in lines:gmatch("[^\r\n]+") do
    local word, value, more = line:match("^%s*(%a+)%f[%s]%s*(%S*)(.*)$")
    if word == "base" then base, rest = value, more end
    if is_asc == nil and line:find("%S") and not line:find("^%s*//") then
      is_asc = word == "date" or word == "base" or read_stamp(line) ~= nil
    end
  end
  return is_asc, base, rest
end

local BASES = { hex = 16, dec = 10 } -- of ids and data

-- Read the first lines by the base in which more of them are frames: "160 107" is not hexadecimal.
local function survey_both(lines)
  local in_hex, in_dec = survey(lines, BASES.hex), survey(lines, BASES.dec)
  return in_dec.frames > in_hex.frames and in_dec or in_hex
end

-- Return what the first lines of a file say, nil if it is not ASC: what survey returns, and
-- is_relative = whether times are those since the line before.  A file whose head says no base
-- needs more frames than other lines.
local function recognise(head)
  local lines = (#head < HEAD and head or head:match("^.*\n") or ""):gsub("^\239\187\191", "")
  local is_asc, said, rest = read_head(lines)
  if not is_asc or said and not BASES[said] then return nil end
  local found = said and survey(lines, BASES[said]) or survey_both(lines)
  found.is_relative = (rest or ""):find("^%s*timestamps%s+relative") ~= nil
  return (said or found.frames > found.others) and found or nil
end

--- Open a file if it is ASC.
-- file     with read and seek, at its begin
-- report   function(text), called with what is to be said of a line
-- returns  a log with read and seek_read, whose buses are called as Wireshark's reader of BLF calls
--          them, and { has_several = whether its first lines have several; drops = as readers.log
--          returns them }; nil for another file
function M.open(file, report)
  local head = file:read(HEAD) or ""
  local log = recognise(head)
  if not log then return nil end
  log.record, log.per_second = read_record, SECOND
  log.date = nil -- of the file
  log.began = nil -- the date of a block until its first stamp comes
  log.start = nil -- what stamps count from, if not from the date
  log.sum = 0 -- the last stamp; if they are relative, the sum of all
  log.rest = 0 -- nanoseconds that the sum leaves out
  log.clock = 0 -- the time of the last line
  return text.open(head, report, log)
end

return M
]=])
module("yapp.file.candump", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The output and logs of candump: the CAN frame in a line, whether a file is such, and its frames
-- as packets.  Pure Lua.
--
-- A line, after can-utils (lib.c, candump.c), has the form LOG or SCREEN behind the CAN id;
-- read_head reads what stands before.  A line without a frame has one of the forms OTHERS.  A line
-- pasted from a document has these forms, too.
local memo = require "yapp.base.memo"
local text = require "yapp.file.text"
local utf8 = require "yapp.base.utf8"

local match = string.match

local M = {}

-- Why a line gives no frame.
local UNKNOWN = "not a candump line, skipped"
local TIME = "no such time, line skipped"
local ID = text.ID
local DATA = text.DATA
-- Notes about a line with a frame.
local BEHIND = "text behind the frame, ignored"
local REPAIRED = "letters that look like hex digits, read as such"

-- Lines without a frame: a pattern, a reason, and whether they are harmless.  candump -e prints
-- below an error frame, behind a tab, what it means.
local OTHERS = {
  { "^%s*$", "an empty line, skipped", true },
  { "^%s*[#;/]", "a comment, skipped", true },
  { "^Enabling Logfile '", "a message of candump's, skipped", true },
  { "while logging[.!]?%s*$", "a message of candump's, skipped", true },
  { "^DROPCOUNT: ", "candump lost frames" },
  { "#%x%x:%x%x:%x+#%x*%s*[RT]?%s*$", "a CAN XL frame, skipped", true }, -- of a log
  { "%[%d%d%d%d%]%s+%(%x%x|", "a CAN XL frame, skipped", true }, -- on the screen
  { "^\t%l+%-[%l-]+%f[{%s\0]" },
}

-- Return the id with SocketCAN's flags for 3 (standard) or 8 (extended, or error) hex digits, or
-- nil.
local function read_id(digits)
  local id = tonumber(digits, 16)
  if #digits == 3 and id < 0x800 then return id end
  if #digits ~= 8 or id >= 2 * text.ERROR then return nil end
  return id < text.ERROR and id + text.EXTENDED or id
end

-- Times -------------------------------------------------------------------------------------------

local latest, latest_seconds = "", nil -- date: many frames are of one second

-- Return the seconds since 1970 of a date, local time as Wireshark shows it; nil for another text.
local function read_date(date)
  if date == latest then return latest_seconds end
  local parts = {}
  parts.year, parts.month, parts.day, parts.hour, parts.min, parts.sec =
    date:match("^(%d%d%d%d)%-(%d%d)%-(%d%d) (%d%d):(%d%d):(%d%d)$")
  latest, latest_seconds = date, parts.year and text.seconds_of(parts)
  return latest_seconds
end

-- Fill in the time in the parentheses, or return why not.  An absolute time has ten digits at
-- least: candump pads it.  Old versions of asc2log write "1.1000000" for two seconds.
local function read_stamp(record, stamp)
  local whole, fraction = stamp:match("^%f[%d]([%d%-: ]*%d)%.(%d+)$")
  if not whole then return TIME end
  record.is_date = #whole > 12
  local read = record.is_date and read_date or tonumber
  record.seconds = read(whole)
  record.nanoseconds = tonumber((fraction .. "00000000"):sub(1, 9))
  record.is_relative = #whole < 10
  record.is_short = #whole == 3 -- as candump pads a time that is not absolute
  if fraction == "1000000" and record.seconds then
    record.seconds, record.nanoseconds = record.seconds + 1, 0
  end
  return not record.seconds and TIME or nil
end

-- Data --------------------------------------------------------------------------------------------

local function fill_remote(record, length)
  record.id = record.id + text.REMOTE
  record.length = length
  record.data = ("\0"):rep(length)
end

-- Lengths that only a CAN FD frame has.
local FD_LENGTHS = {
  [12] = true, [16] = true, [20] = true, [24] = true, [32] = true, [48] = true, [64] = true,
}

-- Fill in the data that a log has behind "#": ##<flags><data> of CAN FD, R<length>_<DLC>,
-- <data>_<DLC>.  Some converters write CAN FD behind one "#", without flags.
local function read_log(record, data, way, stop, line)
  local has_more = stop <= #line
  if has_more then record.note = BEHIND end
  record.sent = way == "T" and not has_more
  record.is_relative = record.is_short -- of candump -L -t d or z; other programs write short times
  local length, dlc = data:match("^R(%d?)_?(%x?)$")
  local flags, hex = data:match("^#(%x)(%x*)$")
  if flags then
    record.fd = true
    record.flags = tonumber(flags, 16)
  elseif not length then
    hex, dlc = data:match("^(%x*)_?(%x?)$")
  end
  record.raw_dlc = tonumber(dlc or "", 16) or 0
  if length then return fill_remote(record, tonumber(length) or 0) end
  if not hex or #hex % 2 ~= 0 then return DATA end
  record.data, record.length = hex:gsub("%x%x", text.BYTES)
  record.fd = record.fd or FD_LENGTHS[record.length] or false
end

-- Fill in the data that the screen has behind the id: [8] classic, [08] CAN FD, {E} classic with
-- the raw DLC (-8).  Between the bytes is a blank, or with -S, which turns them around, a "`".
-- Behind them is nothing, ERRORFRAME, or in quotes the bytes as ASCII.
local function read_screen(record, open, digits, data)
  local is_raw = open == "{"
  local length = tonumber(digits, is_raw and 16 or 10)
  if not length then return DATA end
  if is_raw and length > 8 then
    record.raw_dlc = length
    length = 8
  end
  record.fd = #digits == 2
  record.length = length
  if data:find("^%s+remote request%s*$") then return fill_remote(record, length) end
  local bytes, stop = text.read_bytes(data, length, "^[%s`]+(%x+)()", text.BYTES)
  if not bytes or not data:find("^%s*$", stop) and not data:find("^%s+['`E]", stop) then
    return DATA
  end
  record.data = data:sub(1, stop - 1):find("`", 1, true) and bytes:reverse() or bytes
end

-- A line ------------------------------------------------------------------------------------------

-- The text behind the id in a line with a frame.
-- (1700000000.000001) can0 08404000#BBBE6FC720000000 R
local LOG = "^#(%S*)%s*([RT]?)%s*()"
--  (000.000499)  can0  RX - -  08404000   [8]  BB BE 6F C7 20 00 00 00   '..o. ...'
local SCREEN = "^%s+([%[{])(%x%x?)[%]}](.*)$"

-- Return the values in front of an id: the time, the bus, with -x the direction and the flags of
-- CAN FD; then the id and the index behind it.  Each may be nil.
local function read_head(line)
  local stamp, first = match(line, "^%s*%(([^()]+)%)%s+()")
  local bus, second = match(line, "^%s*(%S+)%s+()", first)
  if not bus then return nil end
  local way, brs, esi, third = match(line, "^([RT])X ([B-]) ([E-])%s+()", second)
  local id, behind = match(line, "^(%x+)()", third or second)
  local flags = (brs == "B" and 1 or 0) + (esi == "E" and 2 or 0)
  return stamp, bus, way == "T", flags, id, behind
end

-- Fill in time and data, or return why not.
local function fill(record, stamp, line, read, a, b, c)
  if not record.id then return ID end
  local why = stamp and read_stamp(record, stamp) or read(record, a, b, c, line)
  local max_length = record.fd and 64 or 8
  return why or record.length > max_length and DATA or nil
end

-- Return the frame in a line, or nil and why there is none.
local function frame_of(line)
  local stamp, bus, sent, flags, id, behind = read_head(line)
  local read, a, b, c = read_screen, match(line, SCREEN, behind)
  -- A log line without a time is of another program.
  if stamp and not a then read, a, b, c = read_log, match(line, LOG, behind) end
  if not (id and a) then return nil, UNKNOWN end
  local record = {
    bus = bus, id = read_id(id), fd = false, sent = sent, flags = flags, raw_dlc = 0,
    is_relative = false, is_short = false,
  }
  local why = fill(record, stamp, line, read, a, b, c)
  if not why then return record end
  return nil, stamp and why or UNKNOWN
end

-- Characters that stand for digits in the candump lines of the vendor's document: three Greek and
-- two Cyrillic letters, an O, and circles; and the space of a page that they were copied from.
local LOOK_ALIKES = {}
for letter, digit in
  ("\206\146B\206\149E\206\1520\208\1513\208\1776\194\160 "):gmatch("([\194-\208].)(.)") do
  LOOK_ALIKES[letter] = digit
end

-- Return the line with such letters as the digits that they stand for.
local function repaired(line)
  line = line:gsub("[\194\206\208][\128-\191]", LOOK_ALIKES)
  line = line:gsub("%$\\odot \\odot%$", "00")
  return (line:gsub("(%x)O%f[%s\0]", "%10"))
end

--- Read a line of candump's output or log.
-- line     text without its line end; colours and a byte order mark are dropped
-- returns  the frame: { bus = name, id = with SocketCAN's flags, fd, flags = of CAN FD: 1 BRS, 2
--          ESI; length = bytes, or the DLC of a remote frame; data = string, zero in a remote
--          frame; raw_dlc = 9 to 15, or 0; sent; seconds, nanoseconds, is_relative = nil without a
--          time; note = a remark on the line, or nil }.  For a line without a frame: nil;
--          a reason, nil for what -e prints below a frame; true if the line is harmless: the packet
--          list need not report it, and the file may still be candump's
function M.parse(line)
  line = line:gsub("^\239\187\191", ""):gsub("\27%[[%d;]*m", "")
  local record, why = frame_of(line)
  if record then return record end
  local readable = repaired(line)
  record = readable ~= line and frame_of(readable)
  if record then
    record.note = REPAIRED
    return record
  end
  for _, other in ipairs(OTHERS) do
    if line:find(other[1]) then return nil, other[2], other[3] end
  end
  return nil, why
end

-- Sizes, in bytes.  A pipe can be rewound only inside Wireshark's own buffer, which has at least
-- HEAD and less than SURE bytes (less than 256 KB on 4.0, than 8 MB on 4.4 and 4.6).
local HEAD = 4096
local SURE = 16 * 1024 * 1024
local PIECE = 1024 * 1024

local SECOND = 1000000000 -- nanoseconds
local MAX_DROPPED = 0xFFFFFFFF -- candump counts them in 32 bits
local NO_BUS = { [""] = true, any = true }

-- Which files are candump's -----------------------------------------------------------------------

-- How many digits Wireshark's own reader takes behind "#", for data, remote and CAN FD frames.
local PLAIN_DIGITS = {
  [""] = "0 2 4 6 8 10 12 14 16", R = "0 1", ["#"] = "1 3 5 7 9 11 13 15 17 25 33 41 49 65 97 129",
}
for kind, counts in pairs(PLAIN_DIGITS) do
  local set = {}
  for count in counts:gmatch("%d+") do set[tonumber(count)] = true end
  PLAIN_DIGITS[kind] = set
end

-- Return a test for text of whole lines: whether all are log lines of this bus that Wireshark's own
-- reader gets right in every version (tests/e2e/test_candump.py compares the two readers).
-- Wireshark's reader takes one space, six decimals, a number of digits that fits, and nothing more.
-- It does not tell two buses apart before 4.6, and an empty line ends the file for it on 4.6.  From
-- 4.6 on it goes by an id's value, not by its digits (by_value): it takes 00000000 for a standard
-- id, and the id of an error frame for an extended one.
local function plain_test(bus, by_value)
  local name = bus:gsub("%W", "%%%0")
  local pattern = "%(%d+%.%d%d%d%d%d%d%) " .. name .. " ([0-7]%x+)#([#R]?)()%x*()\r?\n"
  local function erase(id, kind, from, to)
    local is_misread = by_value and (id < "00000800" or id >= "20000000")
    local is_id = #id == 3 or #id == 8 and not is_misread
    return is_id and PLAIN_DIGITS[kind][to - from] and "" or nil
  end
  return function(lines) return lines:gsub(pattern, erase) == "" end
end

-- Return the relative time of a record in nanoseconds, 0 if it has none.
local function relative_time(record)
  return record.is_relative and record.seconds * SECOND + record.nanoseconds or 0
end

-- Return whether the times are those since the frame before (candump -t d), not those since the
-- first one (-t z).  On one bus, times since the first frame climb, or stay if an adapter stamps
-- several frames at once.  Times since the frame before go up and down, or repeat.  (Of several
-- buses two frames may change places.)
local function are_deltas(records)
  local last, falls, repeats, rises = {}, 0, 0, 0
  for _, record in ipairs(records) do
    local time, before = relative_time(record), last[record.bus]
    if time < (before or 0) then
      falls = falls + 1
    elseif time > (before or time) then
      rises = rises + 1
    elseif before and time > 0 then
      repeats = repeats + 1
    end
    last[record.bus] = time
  end
  if falls > 0 or rises <= 1 then falls = falls + repeats end
  return 10 * falls > #records
end

-- Return whether not all records have the time stamp of the first one.
local function do_stamps_differ(records)
  local first = records[1]
  for _, record in ipairs(records) do
    if record.seconds ~= first.seconds or record.nanoseconds ~= first.nanoseconds then
      return true
    end
  end
  return false
end

-- Cut text behind its last line end.  At the end of the file all of it is lines.
local function whole_lines(piece, at_end)
  local lines = piece:match("^.*\n") or ""
  local rest = piece:sub(#lines + 1)
  if at_end and rest ~= "" then return piece .. "\n", "" end
  return lines, rest
end

-- Patterns of a line whose start was cut off: an id and "#", a length, data bytes alone.
local RESTS = { "%x#", "[%[{]%x+[%]}]", "^#?[%x%s`]*$", "^#?[%x%s`]*[RT]%s*$" }

-- Return whether candump text may start with these lines without a frame: the rest of a line, in a
-- log that was cut at its start, or a shell's lines with the command.  Any other first line may be
-- the mark of another format.
local function may_begin(lines)
  if #lines == 0 or table.concat(lines, "\n"):find("candump ", 1, true) then return true end
  for _, rest in ipairs(RESTS) do
    if #lines == 1 and lines[1]:find(rest) then return true end
  end
  return false
end

-- Survey the first lines of a file; return nil if they are not candump's: { deltas = whether
-- the times are those since the frame before, decimals = 6 or 9, bus = name of the first one,
-- has_several = whether there are others, stamps_differ = whether not all stamps are equal }.
local function recognise(lines)
  local records, others = {}, {}
  local found = { decimals = 6, has_several = false }
  for line in lines:gmatch("([^\n]*)\n") do
    local record, why, is_harmless = M.parse(line)
    if record then
      if #records == 0 and not may_begin(others) then return nil end
      records[#records + 1] = record
      found.bus = found.bus or record.bus
      if record.bus ~= found.bus then found.has_several = true end
      if (record.nanoseconds or 0) % 1000 ~= 0 then found.decimals = 9 end
    elseif why and not is_harmless then
      others[#others + 1] = line
    end
  end
  found.deltas, found.stamps_differ = are_deltas(records), do_stamps_differ(records)
  return #records > #others and found or nil
end

-- Look behind a plain start for a line that needs this reader.  A file that cannot be rewound is a
-- pipe: no other reader could read it any more, so it is taken.  All text is kept until that is
-- known.
-- returns  the text read from the start of the file, which is right behind it; nil if the whole
--          file is plain
local function text_that_needs_us(file, head, is_plain)
  local all, size = head, #head
  local lines, rest = whole_lines(head, false)
  while is_plain(lines) and #rest <= HEAD do
    local more = file:read(PIECE) or ""
    size = size + #more
    if size < SURE then
      all = all .. more
      if not file:seek("set", 0) then return all end
      file:seek("set", size)
    end
    lines, rest = whole_lines(rest .. more, more == "")
    if more == "" and is_plain(lines) then return nil end
  end
  file:seek("set", #head)
  return head
end

-- A file ------------------------------------------------------------------------------------------

-- Add a bus: { number = the one its name ends in (can1 is 1) unless another bus has it, else the
-- first free one; name = fit to be printed; heads = of packets, by the id's digits }.
local function add_bus(log, name)
  while log.taken[log.free] do log.free = log.free + 1 end
  local number = tonumber(name:match("%f[%d]%d?%d?%d$"))
  if not number or log.taken[number] then number = log.free end
  log.taken[number] = true
  local shown = utf8.name(name)
  local heads = memo(function(digits)
    local id = read_id(digits)
    return id and text.head(number, { id = id })
  end)
  log.buses[name] = { number = number, name = shown, heads = heads }
  log.pending[#log.pending + 1] = ("Interface index %d is %s"):format(number, shown)
end

-- A line that has one of these, and was not understood, was a frame.
local LIKE_FRAMES = { "^%s*%([%d-]", "%x#", "%[%x+%]%s", "{%x}%s" }

local function has_one_of(line, patterns)
  for _, pattern in ipairs(patterns) do
    if line:find(pattern) then return true end
  end
  return false
end

-- Account for a line without a frame: note the packets that candump says it lost.
local function add_drop(log, line, why, is_harmless)
  local count, bus = line:match("^DROPCOUNT: dropped (%d+)[^']*'?([^',]*)")
  if not count then
    if is_harmless then return log:skip(line, why, true) end
    return log:lose(line, why, not has_one_of(line, LIKE_FRAMES))
  end
  log:skip(line, why)
  log.drops[#log.drops + 1] = {
    count = math.min(tonumber(count), MAX_DROPPED),
    bus = not NO_BUS[bus] and utf8.name(bus) or nil,
  }
end

local HOUR = 3600 -- seconds

-- Local times (candump -t A) go back by an hour when summer time ends.  Let the time go on: add an
-- hour, until the reader's own time zone does so, too, if it has the same summer time.
--   02:59:59, 02:00:00, 02:30:00: the last two are 03:00:00 and 03:30:00
local function go_on_over_hour(log, record, offset)
  local step = record.seconds - (log.latest_date or record.seconds)
  log.latest_date = record.seconds
  if step >= -HOUR and step < -HOUR / 2 then
    log.hour = log.hour + HOUR
  elseif log.hour > 0 and step >= HOUR then
    log.hour = log.hour - HOUR
  end
  log.shifts[offset] = log.hour > 0 and log.hour or nil
end

-- Return the frame in a line, as text.open says.
local function read_record(log, line, offset)
  local record, why, is_harmless = M.parse(line)
  if not offset then return record end
  if why then add_drop(log, line, why, is_harmless) end
  if not record then return nil end
  if not log.buses[record.bus] then add_bus(log, record.bus) end
  if log.deltas then
    log.clock = log.clock + relative_time(record)
    log.times[offset] = record.is_relative and log.clock or nil
  end
  if record.is_date then go_on_over_hour(log, record, offset) end
  if record.note then log:skip(line, record.note) end
  return record
end

-- A classic data frame in a log, nothing behind it: (1700000000.000001) can0 08404000#BBBE6FC7
local USUAL = "^%((%d+)%.(%d%d%d%d%d%d)%) (%S+) (%x+)#(%x*)\r?\n()"

-- Read the next frame.  Nearly all lines of a large file have the usual form.  Their packets are
-- made without a record, in half of the time.
local function next_frame(log, lines, file)
  local seconds, fraction, name, digits, hex, stop = lines.text:match(USUAL, lines.pos)
  local bus = log.buses[name]
  local head = bus and #hex <= 16 and #hex % 2 == 0 and #seconds <= 12 and bus.heads[digits]
  if not head then return text.next(log, lines, file) end
  local offset = lines:skip_to(stop)
  local data = hex:gsub("%x%x", text.BYTES)
  local bytes = head .. string.char(#data) .. "\0\0\0" .. data
  return offset, bytes, tonumber(seconds), fraction * 1000, bus, log.comments[offset]
end

--- Open a file if it is candump text.
-- file     anything with read(bytes) and seek("set", offset), at its start, as io.open gives it
-- options  { all = true to take all candump text, false to leave to Wireshark's own reader what
--          that gets right; by_value = whether that reader goes by the value of an id, as 4.6 does;
--          report = function(text), called with a remark on a line }
-- returns  a log with read and seek_read, and { decimals = 6 or 9, of the times; has_several =
--          whether its first lines have several buses; stamps_differ, drops = as readers.log
--          returns them }.  Otherwise nil, and if Wireshark's own reader gets the log right, what
--          readers.log returns: { plain_bus, stamps_differ }
function M.open(file, options)
  local head = file:read(HEAD) or ""
  if head:find("\0", 1, true) then return nil end
  local lines = whole_lines(head, #head < HEAD)
  local log = recognise(lines)
  if not log then return nil end
  local is_plain = plain_test(log.bus, options.by_value)
  if not (options.all or log.deltas) and is_plain(lines) then
    head = text_that_needs_us(file, head, is_plain)
    if not head then
      return nil, { plain_bus = utf8.name(log.bus), stamps_differ = log.stamps_differ }
    end
  end
  log.record, log.next = read_record, not log.deltas and next_frame or nil
  log.per_second = SECOND
  log.clock = 0 -- sum of the deltas in nanoseconds
  log.latest_date = nil -- seconds of the latest time that was a date
  log.hour = 0 -- seconds to add to dates
  log.taken = {} -- by number: whether a bus has it
  log.free = 0 -- all numbers below are taken
  return text.open(head, options.report, log)
end

return M
]=])
module("yapp.file.dump", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- A raw serial dump as packets: the file of `cat /dev/ttyUSB0 > run.yapp`.  Pure Lua.

local M = {}

local CHUNK = 65536
local MAX_AHEAD = 1048576 -- bytes to search for a time stamp; they are kept
local MAX_SKIPPED = 65536 -- bytes of no frame in a record; Wireshark takes four times that
local ID_FROM, ID_TO = 5, 8 -- bytes of a frame that are its ID

-- A record is an exported PDU: it names its dissector, and a UDP port type says that it is complete
-- in itself.  Bytes between frames may look like the start of a frame.  Only the bytes behind them
-- prove that they are not, so they have a dissector of their own.
local DISSECTOR, UDP = "\0\12\0\12", "\0\24\0\4\0\0\0\3\0\0\0\0" -- tags, each with its length
local FRAME = DISSECTOR .. "yapp_serial\0" .. UDP
local SKIPPED = DISSECTOR .. "yapp_skipped" .. UDP

-- Times ------------------------------------------------------------------------------------------

-- A time is { seconds, nanoseconds = 0 to 999999999 }: 2^63 ns are too many for one number.
local UNKNOWN = {}
local ZERO = { 0, 0 }
local SECOND = 1000000000
local MAX_CLOCKS = 4 -- of an ID
local MAX_STEP = 1 -- seconds

local function sum(a, b)
  local seconds, nanoseconds = a[1] + b[1], a[2] + b[2]
  if nanoseconds >= SECOND then return { seconds + 1, nanoseconds - SECOND } end
  return { seconds, nanoseconds }
end

local function difference(a, b)
  local seconds, nanoseconds = a[1] - b[1], a[2] - b[2]
  if nanoseconds < 0 then return { seconds - 1, nanoseconds + SECOND } end
  return { seconds, nanoseconds }
end

local function is_before(a, b)
  return a[1] < b[1] or a[1] == b[1] and a[2] < b[2]
end

-- Return the clock of an ID that goes on with a stamp: the one that advances least.
local function clock_of(clocks, stamp)
  local found
  for _, clock in ipairs(clocks) do
    local may_be = not is_before(stamp, clock.last)
    if may_be and not (found and is_before(clock.last, found.last)) then found = clock end
  end
  return found
end

local Dump = {}
Dump.__index = Dump

-- Read more bytes, and append their findings.
function Dump:fill(file)
  local bytes = self.head or file:read(CHUNK) or ""
  self.head, self.is_over = nil, bytes == ""
  self.framer:add(bytes, self.is_over, self.findings)
end

-- Return the controller's own time of a frame, nil for none.
function Dump:stamp(finding)
  if finding.status ~= "good" then return nil end
  local seconds, nanoseconds = self.time_of(finding.bytes)
  return seconds and { seconds, nanoseconds }
end

-- Return how far the time of the dump is ahead of a clock that begins with this stamp.  Messages of
-- one controller have one clock.  So use the clock of the latest message if that makes a small step
-- forward; else time goes on from the latest record.
--   latest record at 102.9 s, its clock 2.9 s: 3.0 s of another ID is 103.0 s, 0.05 s is 102.9 s
local function shift_of(self, stamp)
  local ahead = difference(sum(stamp, self.shift), self.time)
  return ahead[1] >= 0 and ahead[1] < MAX_STEP and self.shift or difference(self.time, stamp)
end

-- Let the time of the dump go on with a stamp.  It never goes back: a controller that rebooted has
-- a new clock, and so has another controller with the same ID.
-- id  of the message
local function advance(self, id, stamp)
  self.time = self.time or stamp
  self.clocks[id] = self.clocks[id] or {}
  local clocks = self.clocks[id]
  local clock = clock_of(clocks, stamp)
  if not clock then
    clock = { shift = shift_of(self, stamp) }
    table.insert(clocks, clock)
    if #clocks > MAX_CLOCKS then table.remove(clocks, 1) end
  end
  clock.last, self.shift = stamp, clock.shift
  local time = sum(stamp, clock.shift)
  if is_before(self.time, time) then self.time = time end
end

--- Open a dump.
-- file     at its first byte, or behind `head`; a pipe will do
-- options  { new_framer = function() -> a serial.framer,
--            time_of = function(bytes of a frame) -> seconds, nanoseconds of the message's own time
--            stamp, nil for none }
-- head     string: the first bytes, if they have been read
-- returns  a log with read and seek_read; nil for a file that holds no good frame
function M.open(file, options, head)
  local self = setmetatable({
    framer = options.new_framer(),
    time_of = options.time_of,
    head = head,
    decimals = 9,
    lacks_clock = true, -- its times are those of controllers
    findings = {}, -- of the file; false once it is a record
    next = 1, -- index of the first one that is no record yet
    is_over = false,
    time = nil, -- of the latest record; before that, the first time stamp of the file
    clocks = {}, -- by ID: list of { last = stamp, shift = of the dump's time from it }
    shift = ZERO, -- of the clock of the latest message that has one
    records = {}, -- [offset] = { length = bytes, tags = FRAME or SKIPPED, time }
  }, Dump)
  local has_frame, index = false, 1
  while not (self.is_over or has_frame and (self.time or self.framer.from >= MAX_AHEAD)) do
    self:fill(file)
    for i = index, #self.findings do
      local finding = self.findings[i]
      has_frame = has_frame or finding.status == "good"
      self.time = self.time or self:stamp(finding)
    end
    index = #self.findings + 1
  end
  return has_frame and self or nil
end

-- Take the next finding, nil at the end.  All bytes between two frames are one finding of at most
-- MAX_SKIPPED bytes, however they were read.
function Dump:next_finding(file)
  local finding = self.findings[self.next]
  local function may_grow()
    if not finding then return true end
    local is_last = finding.status == "skipped" and not self.findings[self.next + 1]
    return is_last and #finding.bytes < MAX_SKIPPED
  end
  while not self.is_over and may_grow() do
    self:fill(file)
    finding = self.findings[self.next]
  end
  if finding and finding.status == "skipped" and #finding.bytes > MAX_SKIPPED then
    local from, bytes = finding.from, finding.bytes
    finding.from, finding.bytes = from + MAX_SKIPPED, bytes:sub(MAX_SKIPPED + 1)
    return { status = "skipped", from = from, bytes = bytes:sub(1, MAX_SKIPPED) }
  end
  if finding then self.findings[self.next], self.next = false, self.next + 1 end
  return finding
end

-- Return a record as Wireshark takes it.
local function packet(record, offset, bytes)
  return offset, record.tags .. bytes, record.time[1], record.time[2]
end

--- Read the next record: a frame, or bytes of no frame.
-- returns  its offset, the packet's bytes (an exported PDU), seconds and nanoseconds; nil at the
--          end.  The time is the controller's own if the message has a time stamp, else that of the
--          record before.  It never goes back: if the controller reboots, it goes on.  Records
--          before the first time stamp get that one if it comes within MAX_AHEAD bytes, else nil
function Dump:read(file)
  local finding = self:next_finding(file)
  if not finding then return nil end
  local stamp = self:stamp(finding)
  if stamp then advance(self, finding.bytes:sub(ID_FROM, ID_TO), stamp) end
  local record = {
    length = #finding.bytes,
    time = self.time or UNKNOWN,
    tags = finding.status == "skipped" and SKIPPED or FRAME,
  }
  self.records[finding.from] = record
  return packet(record, finding.from, finding.bytes)
end

--- Read a record that was read before.
-- offset   of the record
-- returns  as Dump:read
function Dump:seek_read(file, offset)
  local record = self.records[offset]
  file:seek("set", offset)
  local bytes = file:read(record.length)
  if not bytes then return nil end
  return packet(record, offset, bytes)
end

return M
]=])
module("yapp.file.readers", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- Wireshark's file readers of candump text, Vector's ASC and raw serial dumps, and what the files
-- say of the capture.  The modules of the formats do the work.

local later = require "yapp.base.later"
local asc = later "yapp.file.asc"
local candump = later "yapp.file.candump"
local dump = later "yapp.file.dump"

local M = {}

local NO_BUS = {}
local bus -- of the record read last
local latest -- the log opened or read last, or the facts of one left to Wireshark

--- Forget all files.  Call it before any reader sees a file: sharkd opens another file without
-- closing the first.
function M.forget()
  bus, latest = NO_BUS, {}
end
M.forget()

--- Return the bus of the record that was read last.  A dissector can ask on a first pass, where
-- records are read and dissected in turns and fields may be absent.
-- returns  its number and its name, fit to be printed; nil if no reader of ours read the record, or
--          it is of a dump
function M.current()
  return bus.number, bus.name
end

--- Return the facts of the log that was opened or read last, each nil for other files.
-- returns  { has_several = whether it has several buses, by its first lines; drops = list of
--          { count = packets that were lost while capturing, bus = name or nil, frame = number of
--          the packet behind the loss or nil, time = that packet's seconds since 1970 or nil },
--          complete when the file has been read; lacks_times = whether packets have no time stamps;
--          stamps_differ = whether the time stamps of its first frames do;
--          lacks_clock = whether times are the controllers' own, as those of a raw dump;
--          plain_bus = name of the only bus of a log that Wireshark's own reader took, which
--          forgets it on 4.0 and 4.4 }
function M.log()
  return latest
end

-- Fill a record with the results of a log's read or seek_read.
-- returns  its offset; false at the end
local function fill(log, frame, offset, bytes, seconds, nanoseconds, its_bus, comment)
  latest = log
  if not offset then return false end
  frame.rec_type = wtap_rec_types.PACKET
  frame.flags = seconds and wtap_presence_flags.TS or 0
  if seconds then
    frame.time = NSTime.new(seconds, nanoseconds)
  else
    log.lacks_times = true
  end
  if comment then frame.comment = comment end
  frame.data = bytes
  bus = its_bus or NO_BUS
  return offset
end

-- Register a reader.  (No tail calls: what a reader does not hold may be collected, and Wireshark
-- writes into it when the reader is back.)
-- title, name  of the reader
-- kind         "rs" is asked before Wireshark's own readers of text, "r" after them
-- encap        link type of its packets
-- open         function(file), which returns a log; or nil, and what M.log returns of a log that is
--              left to Wireshark's own reader
-- extension    of the files that Wireshark offers to it first, or nil
local function register(title, name, kind, encap, open, extension)
  local handler = FileHandler.new(title, name, title, kind)
  handler.extensions = extension

  function handler.read_open(file, capture)
    bus = NO_BUS
    local log, plain_log = open(file)
    latest = log or plain_log or latest
    if not log then return false end
    capture.encap = encap
    capture.time_precision = log.decimals == 9 and wtap_tsprecs.NSEC or wtap_tsprecs.USEC
    capture.private_table = log
    return true
  end

  function handler.read(file, capture, frame)
    local log = capture.private_table
    local offset = fill(log, frame, log:read(file))
    return offset
  end

  function handler.seek_read(file, capture, frame, offset)
    local log = capture.private_table
    return fill(log, frame, log:seek_read(file, offset)) ~= false
  end

  function handler.read_close() bus = NO_BUS end
  register_filehandler(handler)
end

-- Return the function that reports a text.  Wireshark names no file here.
local function reporter(name)
  return function(text) io.stderr:write(name, ": ", text, "\n") end
end

-- Register a reader of candump text, all of it or what Wireshark's own reader gets wrong or not at
-- all.  A user who names it, -X "read_format:yapp_candump", gets all.
local function register_candump(title, name, kind, takes_all)
  local options = {
    all = takes_all,
    report = reporter("candump reader"),
    -- Wireshark's own reader goes by an id's value from 4.6 on.
    by_value = not get_version():find("^4%.[0-4]%."),
  }
  register(title, name, kind, wtap_encaps.SLL2, function(file)
    return candump.open(file, options)
  end)
end

-- Nothing at the start of a dump marks it, and other files may hold YAPP frames.  So a file is a
-- dump only if its name ends with .yapp, or if the user says so.  Wireshark does not tell a reader
-- the name.  It asks the readers without an extension first, unless the file has the extension of
-- another.  So the reader yapp_name, which opens nothing, notes the files that are not .yapp.
local NO_FRAME = "no YAPP frame with a good CRC, and the size that its ID has, in the whole file"
local HEAD = 256 -- bytes by which a file is known again

local function register_dump(options)
  -- shown: first bytes of a file with another name.  refused: first bytes of a .yapp file without a
  -- frame, as Wireshark shows that to the other reader next.
  local shown, refused
  local report = reporter("yapp: not opened as a raw serial dump")
  local encap = wtap_encaps.WIRESHARK_UPPER_PDU

  register("YAPP (tells other files from .yapp)", "yapp_name", "r", encap, function(file)
    local head = file:read(HEAD) or ""
    if head ~= refused then shown = head end
    refused = nil
  end)

  register("YAPP raw serial dump", "yapp_dump", "r", encap, function(file)
    local head = file:read(HEAD) or ""
    local has_other_name = shown == head
    shown = nil
    if has_other_name then return nil end
    local log = dump.open(file, options, head)
    if log then return log end
    refused = head
    report(head == "" and "the file is empty" or NO_FRAME)
  end, "yapp")
end

--- Register the readers with Wireshark.  Call it once.
-- options  of dump.open
function M.register(options)
  register_candump("candump text (YAPP reader, automatic)", "yapp_candump_auto", "rs", false)
  register_candump("candump text (YAPP reader)", "yapp_candump", "r", true)
  local report = reporter("ASC reader")
  register("Vector ASC (YAPP reader)", "yapp_asc", "r", wtap_encaps.SLL2, function(file)
    return asc.open(file, report)
  end, "asc")
  register_dump(options)
end

return M
]=])
module("yapp.file.text", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- What the readers of text logs share: the lines of a file, a CAN frame as a packet, and a log that
-- reads its frames in order and once more.  Pure Lua.
local char, match = string.char, string.match
local memo = require "yapp.base.memo"
local utf8 = require "yapp.base.utf8"

local M = {}

local BLOCK = 65536 -- bytes read at once
-- Bytes of a line.  The longest lines with a frame are candump's of 64 bytes in binary digits, 700
-- characters.  What is longer is skipped, and never kept whole.
local MAX_LINE = 4096
local MAX_REPORTED = 3 -- lines for each reason
local TOO_LONG = "a line longer than 4096 bytes, skipped"
local COMMENT = "^%s*[#;/]"
local SECOND = 1000000000 -- nanoseconds
local MARK = "\239\187\191" -- a byte order mark, in front of UTF-8

--- Why a line gives no frame.
M.ID = "no such CAN id, line skipped"
M.DATA = "the data bytes do not fit, line skipped"

-- Lines -------------------------------------------------------------------------------------------

local Lines = {}
Lines.__index = Lines

--- Make the lines of a file.
-- text  string: the first bytes of the file, which is right behind them
function M.lines(text)
  return setmetatable({
    text = text, -- a part of the file
    base = 0, -- the offset of the text
    pos = text:sub(1, #MARK) == MARK and #MARK + 1 or 1, -- index at which the next line begins
    number = 0, -- of the line read last
  }, Lines)
end

--- Go to an offset, inside the text where possible.
function Lines:go_to(file, offset)
  local pos = offset - self.base + 1
  if pos >= 1 and pos <= #self.text then
    self.pos = pos
    return
  end
  file:seek("set", offset)
  self.text, self.base, self.pos = "", offset, 1
end

-- Read more bytes behind the line that begins at pos.  Keep only the beginning of a line
-- that is too long.
-- returns  false at the end of the file
function Lines:read_on(file)
  local begin = self.text:sub(self.pos, self.pos + MAX_LINE)
  local more, why = file:read(BLOCK)
  if why then
    error(("cannot read the line at offset %d: %s"):format(self.base + self.pos - 1, why), 0)
  end
  self.base = self.base + #self.text - #begin
  self.text = begin .. (more or "")
  self.pos = 1
  return #self.text > #begin
end

--- Go on behind a line of the text.
-- pos      index in the text at which the next line begins
-- returns  the offset of the line
function Lines:skip_to(pos)
  local offset = self.base + self.pos - 1
  self.pos = pos
  self.number = self.number + 1
  return offset
end

--- Read the next line.
-- returns  the line without its "\n", and its offset; nil at the end.  A line that is too long may
--          have lost its end
function Lines:next(file)
  local stop = self.text:find("\n", self.pos, true)
  while not stop and self:read_on(file) do
    stop = self.text:find("\n", 1, true)
  end
  if not stop and self.pos > #self.text then return nil end
  local line = self.text:sub(self.pos, (stop or 0) - 1)
  return line, self:skip_to((stop or #self.text) + 1)
end

-- Bytes -------------------------------------------------------------------------------------------

--- Make a table of bytes by their digits, filled as it is read; nil for other digits.
-- value_of  function(digits), which returns a number or nil
function M.byte_table(value_of)
  return memo(function(digits)
    local value = value_of(digits)
    return value and value <= 255 and char(value) or nil
  end)
end

-- Two hex digits, or the eight binary ones of candump -i, to a byte.
local BASES = { [2] = 16, [8] = 2 }
M.BYTES = M.byte_table(function(digits)
  local base = BASES[#digits]
  return base and tonumber(digits, base)
end)

--- Return so many data bytes, and the index behind them; nil if there are fewer.
-- data     text that begins with them
-- pattern  of a byte, which captures its digits and the index behind it
-- bytes    from byte_table
function M.read_bytes(data, count, pattern, bytes)
  local found, index = {}, 1
  for i = 1, count do
    local digits, stop = match(data, pattern, index)
    found[i] = bytes[digits or ""]
    if not found[i] then return nil end
    index = stop
  end
  return table.concat(found), index
end

-- Packets -----------------------------------------------------------------------------------------

-- Flags in the upper bits of a SocketCAN id (linux/can.h).
M.EXTENDED = 0x80000000
M.REMOTE = 0x40000000
M.ERROR = 0x20000000

local function big_endian(number)
  return (("%08X"):format(number):gsub("%x%x", M.BYTES))
end

--- Return the bytes of a packet before the CAN frame's length: the same for all frames with this id
-- on a bus.  (Wireshark takes the id in the host's order here, and this is the usual one.)
-- number  of the bus
-- record  { id = 32 bits with SocketCAN's flags, fd, sent = booleans or nil }
function M.head(number, record)
  local protocol = record.fd and "\0\13" or "\0\12"
  local sent = record.sent and "\4" or "\0"
  -- Linux cooked capture v2: protocol, reserved, interface index, device type, packet type, no
  -- address
  return protocol .. "\0\0" .. big_endian(number) .. "\1\24" .. sent .. ("\0"):rep(9) ..
    big_endian(record.id):reverse()
end

--- Return a frame as a packet of link type LINUX_SLL2: the cooked header, the SocketCAN header, the
-- data.
-- number  of the bus
-- record  what head needs, and { length = bytes, flags = 4 FDF, 2 ESI, 1 BRS, raw_dlc = 9 to 15
--         or 0, data = bytes }
function M.packet(number, record)
  local lengths = char(record.length, record.flags, 0, record.raw_dlc)
  return M.head(number, record) .. lengths .. record.data
end

-- What stands in a line ---------------------------------------------------------------------------

--- Return the seconds since 1970 of a local time, or nil if it does not exist.
-- date  { year, month, day, hour, min, sec = numbers or their digits }, which os.time may change
function M.seconds_of(date)
  local written = ("%02d-%02d %02d:%02d"):format(date.month, date.day, date.min, date.sec)
  local is_known, seconds = pcall(os.time, date)
  -- 30 February is moved into March.  The hour may be moved, if summer time leaves it out.
  return is_known and os.date("%m-%d %M:%S", seconds) == written and seconds or nil
end

-- Logs --------------------------------------------------------------------------------------------

local Log = {}
Log.__index = Log

--- Make a log.
-- head    string: the first bytes of the file, which is right behind them
-- report  function(text), called with what is to be said of a line
-- log     table: the state of the format, with
--         record      function(log, line, offset), which returns the frame in a line, or nil: a
--                     record as packet needs it, and { bus = key of buses; seconds, nanoseconds =
--                     nil without a time }.  offset = of the line; nil if it has been read before
--         per_second  unit of times
function M.open(head, report, log)
  log.report = report
  log.lines = M.lines(head)
  log.again = M.lines("") -- for the frames that are read once more
  log.others = 0 -- number of lines without a frame
  log.skipped = {} -- number of lines, by reason
  log.pending = {} -- texts for the packet list, at the next frame
  log.comments = {} -- texts of the packet list, by the frame's offset
  log.buses = {} -- { number, name = fit to be printed }, by the record's bus
  log.times = {} -- by the frame's offset, if its record has none
  log.shifts = {} -- by the frame's offset: seconds to add to the time of its record
  log.drops = {} -- as readers.log returns them
  log.unread, log.doubtful = 0, 0 -- number of lines since the latest frame: not understood
  log.has_frame = false -- whether one was read
  return setmetatable(log, Log)
end

--- Report a line, at once and in the packet list at the next frame.  Of each reason only the first
-- lines are reported.
-- why          text
-- is_harmless  true if the packet list need not say it
function Log:skip(line, why, is_harmless)
  local count = (self.skipped[why] or 0) + 1
  self.skipped[why] = count
  if count > MAX_REPORTED then return end
  local shown = utf8.printable(line:sub(1, 50):match("^%s*(.-)%s*$"))
  local message = ('line %d: %s: "%s"'):format(self.lines.number, why, shown)
  if count == MAX_REPORTED then message = message .. "; further ones are not reported" end
  self.report(message)
  if not is_harmless then self.pending[#self.pending + 1] = message end
end

--- Report a line that was not understood.  It counts as a lost packet.
-- is_doubtful  true if it may be no frame: then it counts only if it stands between two frames
function Log:lose(line, why, is_doubtful)
  local kind = is_doubtful and "doubtful" or "unread"
  self[kind] = self[kind] + 1
  self:skip(line, why)
end

-- Note which frame is behind the latest drops, and when it came: nothing at the end of the file.
local function end_drops(self, frame, time)
  local count = self.unread + (frame and self.has_frame and self.doubtful or 0)
  self.unread, self.doubtful, self.has_frame = 0, 0, true
  if count > 0 then self.drops[#self.drops + 1] = { count = count } end
  for i = #self.drops, 1, -1 do
    local drop = self.drops[i]
    if drop.frame then break end
    drop.frame, drop.time = frame, time
  end
end

-- Return the seconds and nanoseconds of a frame, nil without a time.
local function time_of(self, record, offset)
  local time = self.times[offset]
  if not time then
    local shift = self.shifts[offset]
    return shift and record.seconds + shift or record.seconds, record.nanoseconds
  end
  local rest = time % self.per_second
  return math.floor((time - rest) / self.per_second), rest * (SECOND / self.per_second)
end

--- Read the next frame.
-- lines    of the log
-- returns  as read
function M.next(self, lines, file)
  local line, offset = lines:next(file)
  if not line then return lines == self.lines and end_drops(self) or nil end
  local record
  if #line > MAX_LINE then
    self:lose(line, TOO_LONG, line:find(COMMENT) ~= nil)
  else
    record = self:record(line, lines == self.lines and offset)
  end
  if not record then
    self.others = self.others + 1
    return M.next(self, lines, file)
  end
  if #self.pending > 0 then
    self.comments[offset] = table.concat(self.pending, "\n")
    self.pending = {}
  end
  local bus, seconds, nanoseconds = self.buses[record.bus], time_of(self, record, offset)
  if lines == self.lines then
    local time = seconds and seconds + nanoseconds / SECOND
    end_drops(self, self.lines.number - self.others, time)
  end
  return offset, M.packet(bus.number, record), seconds, nanoseconds, bus, self.comments[offset]
end

Log.next = M.next

--- Read the next frame.
-- file     the file that was opened
-- returns  its offset, the packet's bytes (link type LINUX_SLL2), the seconds and nanoseconds since
--          1970 or since the first frame (nil without a time), the bus { number, name }, a comment
--          or nil.  Nil at the end
function Log:read(file)
  return self:next(self.lines, file)
end

--- Read a frame once more.
-- file     a second handle of the same file, used for nothing else
-- offset   of the frame, from read
-- returns  the same as read
function Log:seek_read(file, offset)
  self.again:go_to(file, offset)
  return self:next(self.again, file)
end

return M
]=])
module("yapp.host.buses", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The bus on which a packet was captured, and the packets that the capture dropped.
-- Wireshark's API.
--
-- The file tells it (host.capture), or the reader of ours that reads the file.  In a live capture,
-- and in a pipe behind its first bytes, fields of the packet tell it: a tap makes Wireshark build
-- the tree that has these.

local capture = require "yapp.host.capture"
local file_readers = require "yapp.file.readers"
local socketcan = require "yapp.host.socketcan"
local stamps = require "yapp.host.stamps"

local M = {}

local FIELDS = "frame.interface_id || frame.interface_name || frame.section_number || " ..
  "sll.ifindex || rtacser.eventtype || frame.packet_flags_direction"
local NAMES = {}
for name in FIELDS:gmatch("[%w_.]+") do NAMES[name] = true end
local IS_TSHARK = not gui_enabled()
local IS_WINDOWS = package.config:sub(1, 1) == "\\"

local Buses = {}
Buses.__index = Buses

-- Return the read positions of all open files of this process, as one text.  Linux tells them; on
-- macOS /dev/fd/N is the open file itself.
local function positions()
  local list = {}
  for number = 3, 63 do
    local info = io.open("/proc/self/fdinfo/" .. number)
    local file = info or io.open("/dev/fd/" .. number)
    list[#list + 1] = info and info:read("*l") or file and file:seek()
    if file then file:close() end
  end
  return table.concat(list, " ")
end

-- Read the first bytes of a capture.
-- returns  the bytes; whether it is a file: more of a pipe must not be read, as Wireshark cannot
--          rewind it further.  In tshark, the read of a file moves the position of an open file.
local function read_head(file)
  local before = positions()
  local head = file:read(capture.HEAD) or ""
  return head, not IS_TSHARK or IS_WINDOWS or positions() ~= before
end

--- Look at the head of each file from now on.  Call it once.
function M.watch()
  local self = setmetatable({ seen = capture.read("", function() end) }, Buses)
  -- Register a reader that opens no file: only a reader's read_open is shown the file.  Give both
  -- arguments a name, so that Lua keeps them: Wireshark writes into both when read_open is back.
  local handler = FileHandler.new("YAPP reads heads of files (opens none)", "yapp_head",
    "Looks at the headers", "rms")
  function handler.read_open(file, _)
    self.has_seen_file = true
    local head, is_file = read_head(file)
    local function more(skip, count)
      if not is_file then return nil end
      if skip > 0 then file:seek("cur", skip) end
      return file:read(count)
    end
    self.seen = capture.read(head, more)
    self.seen_stamps_differ = stamps.differ(head)
    self.is_short = #head < capture.HEAD
    self.is_long_pipe = not (self.is_short or is_file)
    file_readers.forget()
    return false
  end
  function handler.read() return false end
  function handler.seek_read() return false end
  register_filehandler(handler)
  self:init()
  return self
end

-- The bus by the fields of the current packet; nil where they do not tell it.
local function bus_by_fields(found)
  local fields = socketcan.fields_of(NAMES)
  local interface, index = fields["frame.interface_id"], fields["sll.ifindex"]
  local event, name = fields["rtacser.eventtype"], fields["frame.interface_name"]
  if not (interface or index or event) then return nil end
  if name == "unknown" then name = nil end
  local section = fields["frame.section_number"] or 1
  local direction = fields["frame.packet_flags_direction"]
  return found:bus_by_fields(section, interface or 0, index or 0, event, name, direction)
end

-- Find the bus of a packet behind those that were read when the file was opened.
-- returns  as find_bus
local function find_later(self, number)
  local bus = self.kept[number] or bus_by_fields(self.found)
  -- The bus that was the only one when the file was opened stays without a number.
  if not self.found.has_several and (bus or 1) == 1 then return nil, true end
  self.kept[number] = bus
  return bus, bus ~= nil
end

-- The least offset of CAN data inside an Ethernet frame (IEEE 1722): it is of that one's interface,
-- which is known if it is the only one.
local IN_ETHERNET = 42

-- Find the bus of a packet, see Buses:init.
-- in_file  of Capture:bus_finder
local function find_bus(self, in_file, number, offset, pinfo)
  local found, bus, name = self.found, nil, nil
  if not found.is_told then bus, name = file_readers.current() end
  if bus then
    found.names[bus] = name
    return bus, true
  end
  if found.has_several then return in_file(number, offset, pinfo) end
  if number > found.count and self.tap then return find_later(self, number) end
  local is_inside = offset >= IN_ETHERNET and found.carriers < 2
  return nil, not found.is_unknown or is_inside
end

-- Return whether fields tell the bus of packets behind those that were read.
local function are_fields_needed(self)
  local found = self.found
  -- A short file may be of a live capture that already had packets when it was opened.
  local may_go_on = self.is_short and found.has_several or found.is_live
  local is_open = self.is_long_pipe and found.yapp_interfaces > 0
  return may_go_on or is_open or self:missed_file()
end

--- Use the file that was seen last: it is about to be dissected.  Files seen before it did not
-- open, or were only previewed in a file dialog.
function Buses:init()
  local found = self.seen
  self.found = found
  self.found_stamps_differ = self.seen_stamps_differ
  self.plain_bus = file_readers.log().plain_bus
  self.kept = {} -- [number of a packet] = its bus, as fields told it: later there may be no tree
  local needs_fields = are_fields_needed(self)
  self.bus_is_per_packet = needs_fields or found.has_several or
    not (found.is_told or self.plain_bus)
  if needs_fields then
    self.tap = self.tap or Listener.new("frame", FIELDS)
  elseif self.tap then
    self.tap:remove()
    self.tap = nil
  end
  local in_file = found:bus_finder(IS_TSHARK, function(number) return find_later(self, number) end)
  local is_all_told = found.is_told and found.has_several and not self.tap
  --- Return where the current packet was captured.
  -- number   of the packet, which Wireshark need not be asked for again
  -- offset   of the bytes in the packet
  -- returns  the number of its bus, nil if the capture has only one or nothing tells it; and
  --          whether the bus is known
  self.of = is_all_told and in_file or function(number, offset, pinfo)
    return find_bus(self, in_file, number, offset, pinfo)
  end
end

--- Whether the capture was opened before the plugin was loaded: Wireshark loaded its Lua plugins
-- again.  Then fields tell the bus, and nothing tells what the file says of dropped packets.
function Buses:missed_file()
  return not (IS_TSHARK or self.has_seen_file)
end

--- Return whether the capture is known to have several buses.
function Buses:are_several()
  return self.found.has_several or file_readers.log().has_several
end

--- Return the packets that the capture dropped: a list of { time = seconds since 1970
-- or nil, frame = number of the packet behind the loss or nil, bus = name or nil, count }.
function Buses:drops()
  local drops = self.found.drops
  return drops[1] and drops or file_readers.log().drops or {}
end

--- Whether packets of the capture have no time stamps.
function Buses:lacks_times()
  local found = self.found
  if found.is_told then return found.lacks_times end -- no reader of ours reads it
  return found.lacks_times or file_readers.log().lacks_times
end

--- Whether nothing tells when packets were captured: they have no times, or those of controllers.
function Buses:lacks_clock()
  return self:lacks_times() or not self.found.is_told and file_readers.log().lacks_clock
end

--- Whether the first packets of the file have different time stamps: then these mean something.
function Buses:stamps_differ()
  return self.found_stamps_differ or file_readers.log().stamps_differ or false
end

--- Return the seconds from the first time stamp of the capture to the current packet.  If the first
-- packet has none, pinfo.rel_ts is of no use: 4.0 counts from 1970, 4.4 and 4.6 say 0.
function Buses:time(pinfo)
  local start = self.found.start
  return start and pinfo.abs_ts - start or pinfo.rel_ts
end

--- Return the name of a bus.
-- bus      its number; nil where the capture has one or tells none apart
-- is_ip    whether the packet came in UDP or TCP, so by any interface
-- returns  text, or nil where the capture names none
function Buses:name(bus, is_ip)
  return self.found:name(bus, is_ip) or not bus and self.plain_bus or nil
end

return M
]=])
module("yapp.host.can", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The dissector of YAPP on CAN: hands each frame to the reading, and the result to the view.
-- Wireshark's API.

local can_id = require "yapp.wire.can_id"
local deferral = require "yapp.host.deferral"
local frame_key = require "yapp.base.frame_key"
local records = require "yapp.reading.records"
local socketcan = require "yapp.host.socketcan"

local M = {}

local fields_of, START = can_id.fields, can_id.START
local PACKET = frame_key.PACKET
-- A method that Lua has to look up in a Tvb costs more than its work.
local length_of, raw_of, reported_of, offset_of = Tvb.len, Tvb.raw, Tvb.reported_len, Tvb.offset

-- YAPP has no remote frames, but captures give a remote frame zeros as data.  So ask of a frame of
-- zeros whether it is remote; if nothing says so, it is a data frame.
local ZEROS = {}
for length = 0, 8 do ZEROS[("\0"):rep(length)] = true end

local Dissector = {}
Dissector.__index = Dissector

--- Make the dissector.
-- reading      a reading.reading
-- view         a show.frame
-- builder      a show.tree
-- buses        a host.buses
-- register_start  function(id, seq), which makes Wireshark call YAPP for the frames behind a Start
--              of an unknown ID
-- settings     its accepts_all: the preference yapp.all_extended
function M.new(reading, view, builder, buses, register_start, settings)
  local self = setmetatable({
    reading = reading,
    view = view,
    builder = builder,
    buses = buses,
    register_start = register_start,
    settings = settings,
    frame = records.new_can_frame(),
  }, Dissector)
  self.deferral = deferral.new(reading, builder, buses, function(...) self:dissect(...) end)
  return self
end

--- Forget the capture file.
function Dissector:reset()
  self.deferral:reset()
  self.offset = self.buses.found.offset -- of the bytes of all frames in their packets, or nil
  -- Whether the bus of a frame has to be asked for.
  self.bus_is_per_packet = self.buses.bus_is_per_packet
  self.has_start = self.buses.found.start -- see Buses:time
  self.frame = records.new_can_frame()
end

-- Fill the record of the current frame; return it, and its wanted parts.
-- is_deferred  whether it comes from a tap, where Wireshark calls every packet visited
local function fill_frame(self, tvb, reported, pinfo, tree, id, accepts_all, is_deferred)
  local frame, number, offset = self.frame, pinfo.number, self.offset or offset_of(tvb)
  if self.bus_is_per_packet then
    local bus, is_bus_known = self.buses.of(number, offset, pinfo)
    frame.bus, frame.is_bus_known = bus or false, is_bus_known
  end
  local fields, key, builder = fields_of[id], number * PACKET + offset, self.builder
  -- A frame above the newest one is new, which saves asking Wireshark.
  local visited = key <= self.reading.newest_key and not is_deferred and pinfo.visited
  local wants = not visited and builder.wanted or builder:wants(tree, pinfo, visited)
  frame.key = key
  frame.number = number
  frame.time = self.has_start and self.buses:time(pinfo) or pinfo.rel_ts
  frame.visited = visited
  frame.can_id = fields
  frame.seq = fields.seq
  -- raw() of an empty Tvb would throw past Lua: not even pcall catches that.
  frame.data = length_of(tvb) > 0 and raw_of(tvb) or ""
  frame.reported = reported
  frame.accepts_all = accepts_all
  frame.is_only_pass = wants.is_only_pass
  frame.wants_state = wants.state
  return frame, wants
end

--- Return whether a later packet was dissected before this one, as in the second pass of two.
function Dissector:is_second_pass(number)
  return frame_key.number(self.reading.newest_key) > number
end

-- Return how many bytes are ours of a frame of zeros that is not dissected now: none of a remote
-- frame, all of one that waits for a tap; nil to dissect it.
local function pass_over(self, frame, tvb, pinfo, tree, id)
  if frame.visited and frame.can_id.ctrl ~= 0 then return nil end -- it was taken for a fragment
  local is_remote = socketcan.is_remote(pinfo)
  if is_remote then return 0 end
  local waits = is_remote == nil and self.deferral:defer(tvb, pinfo, tree, id, frame.accepts_all)
  return waits and frame.reported or nil
end

-- Register the ids of the frames behind the Start of an unknown message.
local function register_unknown(self, frame)
  if frame.can_id.ctrl == START then self.register_start(frame.can_id.id, frame.seq) end
end

--- Dissect one frame.
-- id           29-bit CAN id
-- accepts_all  whether the user says that every extended frame is YAPP
-- length       of a deferred frame, whose Tvb does not know it: its bytes on the bus; else nil
-- returns      the number of bytes that are ours, 0 for a frame that is not
function Dissector:dissect(tvb, pinfo, tree, id, accepts_all, length)
  local reported = length or reported_of(tvb)
  if reported == 0 then return 0 end
  local frame, wants = fill_frame(self, tvb, reported, pinfo, tree, id, accepts_all, length)
  local passed = ZEROS[frame.data] and pass_over(self, frame, tvb, pinfo, tree, id)
  if passed then return passed end
  local visited, reading = frame.visited, self.reading
  local result = visited and reading:recall_frame(frame)
  if not visited then result = reading:add_frame(frame) end
  if not result then
    self.deferral:note(tvb, pinfo)
    return 0
  end
  if not frame.source.message then register_unknown(self, frame) end
  if wants.shows or not result.is_usual then self.view:show(result, wants, tvb, pinfo, tree) end
  return reported
end

--- Return the dissector for SocketCAN's table of ids, where match_uint is the CAN id.
-- calls  { begun, ended = numbers }, which it counts
function Dissector:of_table(calls)
  return function(tvb, pinfo, tree)
    calls.begun = calls.begun + 1
    local accepts_all = self.settings.accepts_all
    local length = self:dissect(tvb, pinfo, tree, pinfo.match_uint, accepts_all)
    calls.ended = calls.ended + 1
    return length
  end
end

--- Dissect a frame that the user calls YAPP, but whose CAN id is not known.
-- returns  the number of bytes that are ours
function Dissector:without_id(tvb, pinfo, tree)
  if not (tvb:len() > 0 and self.deferral:defer(tvb, pinfo, tree, nil, true)) then
    self.view:show_without_id(self.builder:wants(tree, pinfo, true), tvb, pinfo, tree)
  end
  return tvb:reported_len()
end

return M
]=])
module("yapp.host.capture", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- What a capture file says of its packets: the bus of each, what buses are called, how many packets
-- were dropped while capturing, and whether YAPP may be in it.  Pure Lua.
--
-- Wireshark does not tell a dissector the interface of a packet.  The file does: this module reads
-- the headers of the blocks of pcapng and of the records of pcap.
--
-- A bus is an interface, an index in it (Linux cooked v2), or a direction in it (RTAC; packet flags
-- of serial lines).  An interface whose packets may have CAN frames inside (Ethernet, PPI) is a bus
-- once one of them has.  An interface of another section with the same name and link type is the
-- same.  Buses that may carry YAPP are numbered from 1 in the order in which they show.

local frame = require "yapp.wire.frame"
local utf8 = require "yapp.base.utf8"

local M = {}

local byte, find, floor, max, min, sub =
  string.byte, string.find, math.floor, math.max, math.min, string.sub

--- How many bytes of a pipe may be read: Wireshark can rewind so many.
M.HEAD = 65536
local CHUNK = 1048576 -- bytes that are read at once, and the most that are held of a block
local MAX_BLOCK = 2 ^ 28 -- bytes; Wireshark refuses longer ones
local MAX_OPTIONS = 64 -- of a block

-- Link types whose packets may carry YAPP: SocketCAN; of serial lines exported PDUs and DLT_USER
-- 0 .. 15, whose packets may have a direction.
local SOCKETCAN = 227
local IS_SERIAL = { [252] = true }
for linktype = 147, 162 do IS_SERIAL[linktype] = true end
local FLAG_DIRECTIONS = { [0] = 0, "rx", "tx" } -- by the lowest two bits of a packet's flags

-- Link types whose packets each tell their bus: RTAC serial, Linux cooked captures.
local RTAC, COOKED, COOKED_2 = 250, 113, 276
local IS_CAN = { ["\0\12"] = true, ["\0\13"] = true } -- protocols: CAN and CAN FD
local DIRECTIONS = { "tx", "rx", "tx", "rx" } -- of an RTAC packet by its event

-- Link types whose packets may have a CAN frame inside: Ethernet (IEEE 1722) and PPI.
local ETHERNET, PPI = 1, 192
local IS_CARRIER = { [ETHERNET] = true, [PPI] = true }
local IS_TAG = { ["\129\0"] = true, ["\136\168"] = true, ["\145\0"] = true } -- of a VLAN
local IS_ACF = { ["\34\240\130"] = true, ["\34\240\5"] = true } -- IEEE 1722: NTSCF, TSCF

-- By link type: function(head) -> what tells a packet's bus from others of its interface; nil for a
-- packet that carries no YAPP.  head: the first HEADER bytes of the packet.
local HEADER = 24
local INDEX_OF = {
  [RTAC] = function(head) return DIRECTIONS[byte(head, 9)] or "tx" end,
  [COOKED] = function(head)
    if IS_CAN[sub(head, 15, 16)] then return 0 end
  end,
  [COOKED_2] = function(head)
    if not IS_CAN[sub(head, 1, 2)] or #head < 16 then return nil end
    local a, b, c, d = byte(head, 5, 8)
    return a * 0x1000000 + b * 0x10000 + c * 0x100 + d
  end,
  [ETHERNET] = function(head)
    local at = 13
    while IS_TAG[sub(head, at, at + 1)] do at = at + 4 end
    if IS_ACF[sub(head, at, at + 2)] then return 0 end
  end,
  [PPI] = function(head)
    if sub(head, 5, 8) == "\227\0\0\0" then return 0 end
  end,
}

local NEXT = -1 -- the time stamp of the next packet is wanted
local TIMES = 2 ^ 40 -- microseconds: times are kept modulo 12 days, see Capture:bus

-- The bytes of a file -----------------------------------------------------------------------------

local Window = {}
Window.__index = Window

function Window:bytes(offset, count)
  return sub(self.text, offset - self.start + 1, offset - self.start + count)
end

-- The number that bytes are, 0 for none; of 8 bytes it has a sign.
function Window:value(bytes)
  if self.is_little then bytes = bytes:reverse() end
  local number = #bytes == 8 and byte(bytes) > 127 and -1 or 0
  for i = 1, #bytes do number = number * 0x100 + byte(bytes, i) end
  return number
end

function Window:number(offset, count)
  return self:value(self:bytes(offset, count))
end

-- Three numbers of four bytes with one call: most of the time goes into these.
local function three_numbers(window, offset)
  local from = offset - window.start
  local a, b, c, d, e, f, g, h, i, j, k, l = byte(window.text, from + 1, from + 12)
  if not window.is_little then
    a, b, c, d, e, f, g, h, i, j, k, l = d, c, b, a, h, g, f, e, l, k, j, i
  end
  return a + b * 0x100 + c * 0x10000 + d * 0x1000000,
    e + f * 0x100 + g * 0x10000 + h * 0x1000000,
    i + j * 0x100 + k * 0x10000 + l * 0x1000000
end

-- Note whether the option epb_dropcount, code 4 and 8 bytes, may be among the bytes at hand.  That
-- costs less than to read the options of each block.
local function note_drop_option(window)
  local option = window.is_little and "\4\0\8\0" or "\0\4\0\8"
  window.may_have_drops = find(window.text, option, 1, true) ~= nil
end

-- Make `count` bytes, at most CHUNK, at an offset available; skip what lies in front of them.
-- returns  whether they are there
function Window:has(offset, count)
  if offset + count <= self.stop then return true end
  local more = self.more(max(0, offset - self.stop), CHUNK)
  if not more then return false end
  self.text = self:bytes(offset, CHUNK) .. more
  self.start, self.stop = offset, offset + #self.text
  note_drop_option(self)
  return offset + count <= self.stop
end

-- Whether bytes have what may be the header of a YAPP frame.
local function has_header(bytes)
  local start = frame.find(bytes, 1)
  while start do
    if frame.is_plausible(bytes, start) then return true end
    start = frame.find(bytes, start + 1)
  end
  return false
end

-- Buses -------------------------------------------------------------------------------------------

local Capture = {}
Capture.__index = Capture

-- Give a bus a name that no other has.  If several buses have the name of its interface, or may
-- have it in a live capture, append "#" and what tells them apart.
local function name_bus(self, number)
  local bus = self.buses[number]
  local name, has_index = bus.name, bus.index ~= 0
  local suffix = "#" .. (has_index and bus.index or bus.interface.number)
  if self.uses[name] > 1 or has_index and self.is_live then name = name .. suffix end
  while self.is_taken[name] do name = name .. suffix end
  self.is_taken[name], self.names[number] = true, name
end

-- The number of a bus, which may be new.
-- index  what tells it from other buses of its interface, 0 if it is the only one
local function bus_number(self, interface, index)
  local number = interface.buses[index]
  if not number then
    local name = interface.name or "if" .. interface.number
    number = #self.buses + 1
    interface.buses[index] = number
    self.buses[number] = { interface = interface, index = index, name = name }
    self.uses[name] = (self.uses[name] or 0) + 1
  end
  return number
end

-- Keep the bus of the latest packet, and when it was captured.
-- offset   of its data
-- seconds  since 1970
-- bus      nil for that of its interface
local function keep_bus(self, window, interface, offset, seconds, bus)
  bus = bus or interface.bus
  if not bus then
    local index = INDEX_OF[interface.linktype](window:bytes(offset, HEADER))
    bus = index and bus_number(self, interface, index) or 0
  end
  self.entries[self.count] = bus * TIMES + floor(seconds * 1e6) % TIMES
end

-- pcapng ------------------------------------------------------------------------------------------

-- The options of a block: { [code] = bytes }.
-- offset, stop  of the first one, and behind the last one
local function read_options(window, offset, stop)
  local options = {}
  for _ = 1, MAX_OPTIONS do
    if offset + 4 > stop or not window:has(offset, 4) then break end
    local code, length = window:number(offset, 2), window:number(offset + 2, 2)
    if code == 0 or offset + 4 + length > stop or not window:has(offset, 4 + length) then break end
    options[code] = options[code] or window:bytes(offset + 4, length)
    offset = offset + 4 + length + -length % 4
  end
  return options
end

-- Time units in a second, by the option if_tsresol.
local function units_per_second(option)
  local exponent = option and byte(option) or 6
  return exponent < 128 and 10 ^ exponent or 2 ^ (exponent - 128)
end

local function interface_of(self, number)
  return self.interfaces[self.first + number + 1]
end

local function seconds_of(interface, high, low)
  return (high * 2 ^ 32 + low) / interface.per_second + interface.shift
end

-- Add an interface to those of the file.
-- name  nil for none
local function new_interface(self, linktype, name)
  local number = #self.interfaces
  local interface = {
    number = number, -- in the file
    section = #self.firsts,
    key = linktype .. (name and "/" .. name or "#" .. number), -- the same in another section
    linktype = linktype,
    name = name and utf8.name(name),
    per_second = 1e6, -- time units
    shift = 0, -- seconds to add to its times
    buses = {}, -- by index
    bus = nil, -- of its packets, 0 if they carry no YAPP; nil if each tells it
    direction = nil, -- of a serial line: the first one that came; that is `bus`
    dropped = 0, -- packets, as the statistics say
    accounted = 0, -- dropped packets, as options of packets say
  }
  self.interfaces[#self.interfaces + 1], self.linktypes[linktype] = interface, true
  return interface
end

-- Note an interface that may carry YAPP.
local function note_interface(self, interface)
  local linktype = interface.linktype
  local is_mixed, is_carrier = INDEX_OF[linktype] ~= nil, IS_CARRIER[linktype]
  local kind = is_carrier and "carriers" or "yapp_interfaces"
  self[kind] = self[kind] + 1
  interface.bus = not is_mixed and bus_number(self, interface, 0) or nil
  if not self.keeps then self.early = self.count end
  self.keeps = is_mixed and not is_carrier or self.carriers + self.yapp_interfaces > 1
  self.has_indexes = self.has_indexes or linktype == COOKED_2
  self.has_serial = self.has_serial or IS_SERIAL[linktype]
end

-- The functions in BLOCKS, below, read a block, whose first CHUNK bytes are available.  They return
-- true to read no further.

local function read_interface(self, window, offset, length)
  if length < 20 then return true end
  local linktype = window:number(offset + 8, 2)
  local options = read_options(window, offset + 16, offset + length - 4)
  local interface = new_interface(self, linktype, (options[2] or ""):match("^[^\0]+"))
  interface.per_second = units_per_second(options[9])
  interface.shift = window:value(options[14] or "")
  if INDEX_OF[linktype] or linktype == SOCKETCAN or IS_SERIAL[linktype] then
    note_interface(self, interface)
  else
    interface.bus = 0
  end
end

-- Return the bus of a packet of a serial line.
-- direction  "rx", "tx" or 0; that which comes first has the bus of the interface
local function bus_of_direction(self, interface, direction)
  interface.direction = interface.direction or direction
  if direction == interface.direction then return interface.bus end
  return bus_number(self, interface, direction)
end

-- Return the options of an enhanced block.
local function packet_options(window, offset, length)
  local captured = three_numbers(window, offset + 20)
  local start, stop = offset + 28 + captured + -captured % 4, offset + length - 4
  return start < stop and read_options(window, start, stop) or {}
end

-- Note how many packets were dropped in front of the latest one.
-- seconds  since 1970 at which that was captured
local function note_drops(self, window, interface, seconds, options)
  local count = window:value(options[4] or "")
  if count == 0 then return end
  interface.accounted = interface.accounted + count
  self.drops[#self.drops + 1] =
    { time = seconds, frame = self.count, interface = interface, count = count }
end

local OBSOLETE, ENHANCED = 2, 6

-- Return the bus of the latest packet, which is of a serial line, by its options.
local function bus_by_flags(self, window, interface, options)
  local flags = window:value(options[2] or "")
  local bus = bus_of_direction(self, interface, FLAG_DIRECTIONS[flags % 4] or 0)
  if bus ~= interface.bus and not self.keeps then
    self.keeps, self.early = true, self.count - 1
  end
  return bus
end

-- Read an enhanced block with a packet of an interface.
local function read_enhanced(self, window, offset, length, interface, seconds)
  local is_serial, options, bus = IS_SERIAL[interface.linktype], nil, nil
  if is_serial then
    self.has_serial_frames = self.has_serial_frames or has_header(window:bytes(offset + 28, length))
    options = packet_options(window, offset, length)
    bus = bus_by_flags(self, window, interface, options)
  end
  if self.keeps then keep_bus(self, window, interface, offset + 28, seconds, bus) end
  if not window.may_have_drops then return end
  options = options or packet_options(window, offset, length)
  note_drops(self, window, interface, seconds, options)
end

-- Read a block with a packet, of the enhanced or of the obsolete kind.
local function read_packet(self, window, offset, length, kind)
  self.count = self.count + 1
  local is_wanted = self.keeps or self.has_serial or window.may_have_drops or self.start == NEXT
  if not is_wanted then return end -- the usual case
  if length < 32 then return true end
  local number, high, low = three_numbers(window, offset + 8)
  if kind == OBSOLETE then number = window:number(offset + 8, 2) end
  local interface = interface_of(self, number)
  if not interface then return self.keeps end
  local seconds = seconds_of(interface, high, low)
  if self.start == NEXT then self.start = seconds end
  if kind == ENHANCED then
    read_enhanced(self, window, offset, length, interface, seconds)
  elseif self.keeps then
    keep_bus(self, window, interface, offset + 28, seconds)
  end
end

-- A simple block has a packet of the section's first interface, without a time.
local function read_simple_packet(self, window, offset)
  self.count, self.lacks_times = self.count + 1, true
  local interface = interface_of(self, 0)
  if not interface then return true end
  if self.keeps then keep_bus(self, window, interface, offset + 12, 0) end
end

-- Read how many packets an interface, or its operating system, dropped so far.
local function read_statistics(self, window, offset, length)
  local interface = interface_of(self, window:number(offset + 8, 4))
  if not interface then return end
  local options = read_options(window, offset + 20, offset + length - 4)
  local own, by_system = window:value(options[5] or ""), window:value(options[7] or "")
  interface.dropped = max(interface.dropped, own, by_system)
end

local function count_packet(self)
  self.count = self.count + 1
end

-- A custom block is a packet without a time.
local function read_custom(self)
  count_packet(self)
  if self.count == 1 then self.start = NEXT end
end

local function stop_reading()
  return true
end

local BLOCKS = {
  [1] = read_interface,
  [OBSOLETE] = read_packet,
  [3] = read_simple_packet,
  [5] = read_statistics,
  [ENHANCED] = read_packet,
  [0xBAD] = read_custom,
  [0x40000BAD] = read_custom,
}
-- Wireshark gives these a frame number, too: of the systemd journal, events of sysdig.
for _, kind in ipairs { 9, 0x204, 0x216, 0x221 } do
  BLOCKS[kind] = count_packet
end
-- Wireshark 4.6 gives these a frame number, 4.4 does not: further events of sysdig.
for _, kind in ipairs { 0x208, 0x217, 0x222 } do BLOCKS[kind] = stop_reading end

local SECTION = 0x0A0D0D0A

-- Begin a section, which has its own byte order and numbers its interfaces from 0.
-- returns  the length of its block
local function read_section(self, window, offset)
  window.is_little = window:bytes(offset + 8, 4) == "\77\60\43\26"
  note_drop_option(window)
  self.first = #self.interfaces
  self.firsts[#self.firsts + 1] = self.first
  return window:number(offset + 4, 4)
end

local function read_pcapng(self, window)
  local offset = 0
  while offset + 12 <= window.stop or window:has(offset, 12) do
    local kind, length = three_numbers(window, offset)
    if kind == SECTION then length = read_section(self, window, offset) end
    length = length + -length % 4 -- as Wireshark does it
    local is_there = offset + length <= window.stop or window:has(offset, min(length, CHUNK))
    if length < 12 or length > MAX_BLOCK or not is_there then break end
    local read = BLOCKS[kind]
    if read and read(self, window, offset, length, kind) then break end
    offset = offset + length
  end
end

-- pcap --------------------------------------------------------------------------------------------

local function read_pcap(self, window, is_little, fractions)
  window.is_little = is_little
  if not window:has(0, 24) then return end
  local linktype = window:number(20, 4) % 0x10000 -- above it: the length of check sequences
  self.linktypes[linktype] = true
  self.offset = linktype == SOCKETCAN and 8 or nil
  self.has_packets = window:has(24, 16)
  if linktype ~= COOKED_2 and linktype ~= RTAC then return end
  local interface = new_interface(self, linktype)
  self.yapp_interfaces = 1
  local offset = 24
  while window:has(offset, 16) do
    local seconds, fraction, length = three_numbers(window, offset)
    if length > MAX_BLOCK then break end
    self.count = self.count + 1
    window:has(offset, 32)
    keep_bus(self, window, interface, offset + 16, seconds + fraction / fractions)
    offset = offset + 16 + length
  end
end

-- By the first four bytes of a file: what reads it; of pcap, whether it is little endian, and the
-- fractions of a second in its times.
local FORMATS = {
  ["\212\195\178\161"] = { read_pcap, true, 1e6 },
  ["\161\178\195\212"] = { read_pcap, false, 1e6 },
  ["\77\60\178\161"] = { read_pcap, true, 1e9 },
  ["\161\178\60\77"] = { read_pcap, false, 1e9 },
  ["\10\13\13\10"] = { read_pcapng },
}

-- The facts of a capture --------------------------------------------------------------------------

-- Complete the list of drops: add drops that only statistics say, and set the names of buses.
local function complete_drops(self)
  local drops = self.drops
  for _, interface in ipairs(self.interfaces) do
    local rest = interface.dropped - interface.accounted
    if rest > 0 then drops[#drops + 1] = { interface = interface, count = rest } end
  end
  for _, drop in ipairs(drops) do
    local interface = drop.interface
    drop.bus = self.has_several and self.names[interface.bus] or interface.name
  end
end

-- Make one of an interface and that of an earlier section which is the same.
local function merge(self, interface, earlier)
  for index, number in pairs(interface.buses) do
    local same = earlier.buses[index] or number
    earlier.buses[index], self.merged[number] = same, same
    if same ~= number then self.uses[interface.name] = self.uses[interface.name] - 1 end
  end
  interface.bus, interface.buses = earlier.bus, earlier.buses
end

-- Make one of the interfaces of different sections that have one name and link type.  If a section
-- has two of them, nothing tells which is which.
local function merge_sections(self)
  local sections, is_unclear, first = {}, {}, {}
  for _, interface in ipairs(self.interfaces) do
    local key, section = interface.key, interface.section
    is_unclear[key] = is_unclear[key] or sections[key] == section
    sections[key] = section
  end
  for _, interface in ipairs(self.interfaces) do
    local key = interface.key
    if first[key] and not is_unclear[key] then merge(self, interface, first[key]) end
    first[key] = first[key] or interface
  end
end

-- Let the first direction of a serial line have its name, now that it is known.
local function name_directions(self)
  for _, interface in ipairs(self.interfaces) do
    local direction, bus = interface.direction or 0, interface.bus
    if direction ~= 0 then
      self.buses[bus].index = direction
      interface.buses[0], interface.buses[direction] = nil, bus
    end
  end
end

-- Set the facts that are known once all packets have been read.
local function conclude(self)
  name_directions(self)
  merge_sections(self)
  self.has_packets = self.has_packets or self.count > 0
  local may_have_more = self.yapp_interfaces > 0 or #self.interfaces == 0
  self.is_live = #self.firsts > 0 and not self.has_packets and may_have_more
  local count = 0
  for number = 1, #self.buses do
    if (self.merged[number] or number) == number then
      name_bus(self, number)
      count = count + 1
    end
  end
  self.has_several = count > 1 or self.is_live and self.has_indexes
  complete_drops(self)
  if not self.has_several then self.entries = {} end
end

local function new_capture()
  return setmetatable({
    yapp_interfaces = 0,
    carriers = 0,
    count = 0,
    early = 0, -- packets before the second interface: all that may be YAPP are of bus 1
    keeps = false, -- whether the buses of packets are wanted
    has_serial = false, -- whether a serial line, whose packets may have a direction, is among them
    has_serial_frames = false, -- whether one of its packets may have a YAPP frame
    has_indexes = false, -- whether Linux cooked v2 is among the interfaces
    entries = {}, -- [number of a packet] = its bus * TIMES + when it was captured
    interfaces = {}, -- of the file
    linktypes = {}, -- [number] = true
    first = 0, -- number of interfaces in the sections before
    firsts = {}, -- by section
    buses = {}, -- list of { interface, index, name = of the interface }
    merged = {}, -- [bus] = the one that it is, of an earlier section
    uses = {}, -- by name: how many buses have it
    names = {},
    is_taken = {}, -- by name
    drops = {},
    lacks_times = false,
    start = false,
    has_packets = false,
    is_unknown = false,
  }, Capture)
end

--- Read the buses of a file.  Of a file without YAPP only the first bytes are read.  One
-- whose interfaces are all Ethernet or PPI is read if a packet in these bytes has a CAN frame.
-- head  its first bytes, M.HEAD at most
-- more  function(skip, count) -> the next bytes behind so many that are skipped, at most `count`;
--       nil at the end, and where a pipe must be left alone
-- returns a capture: {
--   yapp_interfaces      number of interfaces that may carry YAPP
--   carriers      number of others, whose packets may have CAN frames inside
--   has_several   whether it tells several buses apart, or will do so in a live capture
--   is_live       whether it is pcapng without a packet yet, as when a capture begins
--   is_told       whether it is of a format that this module reads
--   is_unknown    whether it may have buses that this module cannot tell apart: a file of Vector
--                 BLF, or pcapng that was not read to its end and may describe them later
--   count         how many packets were read
--   names         [bus] = its name
--   drops         list of { time = seconds since 1970 or nil, frame = number of the packet behind
--                 the loss or nil, bus = name or nil, count = packets that were dropped }
--   lacks_times   whether packets have no time stamps
--   start         if the first packet has no time stamp: that of the next one, seconds since 1970
--   offset        of the CAN frame's data in each packet; nil where it is not always the same
--   head          its first bytes, if it has packets and these may have YAPP frames, in TCP, UDP or
--                 others
--   has_serial_frames  whether a packet of a serial line in pcapng may have a YAPP frame
--   may_have_frames  whether its first bytes may have YAPP frames, or it has no packets yet }
function M.read(head, more)
  local self, has_frame = new_capture(), has_header(head)
  local window = setmetatable({ text = head, start = 0, stop = #head, is_little = true }, Window)
  function window.more(skip, count)
    if self.yapp_interfaces > 0 or self.buses[1] or has_frame then return more(skip, count) end
    self.is_unknown = #head >= M.HEAD
  end
  local magic = sub(head, 1, 4)
  local format = FORMATS[magic]
  if format then format[1](self, window, format[2], format[3]) end
  self.is_unknown = self.is_unknown or magic == "LOGG"
  self.is_told = format ~= nil and not self.is_unknown
  conclude(self)
  if self.start == NEXT then self.start = false end
  self.head = has_frame and self.has_packets and head or nil
  self.may_have_frames = has_frame or not self.has_packets
  return self
end

--- Return the options of tshark that may decode YAPP in the capture's serial lines: a list.
function Capture:serial_options()
  local user, list = {}, {}
  for linktype in pairs(self.linktypes) do
    if IS_SERIAL[linktype] and linktype <= 162 then user[#user + 1] = linktype end
  end
  table.sort(user)
  if user[1] then list[1] = "-o yapp.user_dlt:" .. table.concat(user, ",") end
  if self.linktypes[RTAC] then list[#list + 1] = "-d rtacser.data,yapp_serial" end
  return list
end

--- Return the bus of a packet that was read.
-- number    of the packet
-- captured  seconds since 1970 at which Wireshark says that it was captured, nil not to compare
-- returns   its bus; 0 where its interface carries no YAPP; nil where the file's packet of this
--           number is another: a read filter has shifted the numbers
function Capture:bus(number, captured)
  if number <= self.early then return 1 end
  local entry = self.entries[number]
  if not entry then return nil end
  local difference = captured and (captured * 1e6 - entry) % TIMES or 0
  if difference > 2 and difference < TIMES - 2 then return nil end
  local bus = floor(entry / TIMES)
  return self.merged[bus] or bus
end

--- Return a function(number, offset, pinfo), which finds the bus of each packet in their order.  It
-- returns the bus, nil where it is not known; and whether it is known.  Once a packet is another
-- than the file's, all that follow are.
-- compares_times  whether pinfo.abs_ts is when the packet was captured
-- later           function(number): the same for packets that were not read
function Capture:bus_finder(compares_times, later)
  local is_shifted = false
  return function(number, _, pinfo)
    if number > self.count then return later(number) end
    local bus = not is_shifted and self:bus(number, compares_times and pinfo.abs_ts or nil)
    is_shifted = not bus
    return bus or nil, not is_shifted
  end
end

-- Return a bus of an interface; the parameters are those of Capture:bus_by_fields.
local function bus_in(self, interface, index, event, direction)
  if direction and IS_SERIAL[interface.linktype] then
    return bus_of_direction(self, interface, FLAG_DIRECTIONS[direction] or 0)
  end
  return bus_number(self, interface, event and (DIRECTIONS[event] or "tx") or index)
end

--- Return the bus of a packet that was not read, by what Wireshark's fields say.
-- section    its number, from 1
-- interface  its number in the section
-- index      of Linux cooked v2, 0 for none; event: of RTAC, or nil
-- name       of the interface, or nil
-- direction  of its flags, or nil
-- returns    a bus; nil where the section was not read
function Capture:bus_by_fields(section, interface, index, event, name, direction)
  local first = self.firsts[section] or section == 1 and 0
  if not first then return nil end
  local number = first + interface
  local record = self.interfaces[number + 1] or
    { number = number, name = name and utf8.name(name), buses = {} }
  self.interfaces[number + 1] = record
  local bus = bus_in(self, record, index, event, direction)
  if not self.names[bus] then name_bus(self, bus) end
  -- In a live capture further indexes may follow, so a bus with an index is one of several at once.
  local is_first = self.is_live and bus == 1 and index ~= 0 and not event
  self.has_several = self.has_several or is_first
  return bus
end

--- Return the name of a bus.
-- bus      nil where the capture has one
-- is_ip    whether the packet came in UDP or TCP, so by any interface
-- returns  text, nil where the capture has no name for it
function Capture:name(bus, is_ip)
  if bus then return self.names[bus] end
  if self.is_unknown and not is_ip then return nil end
  local only = not is_ip and not self.has_several and self.buses[1]
  local interface = only and only.interface or self.interfaces[1]
  if only or #self.interfaces == 1 then return interface and interface.name end
end

return M
]=])
module("yapp.host.command", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The wishes of tshark's command line that the API does not tell.  Wireshark's API.

local command_line = require "yapp.base.command_line"

local M = {}

--- Return the options of the command line, see base.command_line; none in Wireshark, and where the
-- system does not tell them.  Linux does.
function M.options()
  local file = not gui_enabled() and io.open("/proc/self/cmdline", "rb")
  if not file then return {} end
  local text = file:read("*a")
  file:close()
  return command_line.options(text)
end

-- Return the number and the time of a file of a ring by the tail of its name,
-- 00002_20261125230028.pcapng or 20261125230028_00002.pcapng; number 0 for another file.
local function file_of(tail)
  local number, stamp = tail:match("^(%d%d%d%d%d)_(%d+)")
  if not number then stamp, number = tail:match("^(%d+)_(%d%d%d%d%d)") end
  return tonumber(number) or 0, stamp
end

--- Count the files in which a live capture with -b went on behind its first one, which is all that
-- tshark analyses.
-- options  of the command line
-- since    os.time() before the capture began
-- returns  their number, 0 without -b; nil if it cannot be known
function M.count_later_files(options, since)
  if not (options.b or options["ring-buffer"]) then return 0 end
  local path = options.w or ""
  local folder, name = path:match("^(.*[/\\])([^/\\]*)$")
  name = name or path
  local base, count = (name:match("^(.*)%.[^.]*$") or name) .. "_", 0
  local first_stamp = os.date("%Y%m%d%H%M%S", since)
  local is_open, files = pcall(Dir.open, folder or ".")
  if not is_open then return nil end
  for file in files do
    local number, stamp = file_of(file:sub(1, #base) == base and file:sub(#base + 1) or "")
    if number > 1 and stamp >= first_stamp then count = count + 1 end
  end
  files:close()
  return count
end

return M
]=])
module("yapp.host.deferral", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- CAN frames whose header is needed.  A dissector sees only the data of a frame, a tap all of its
-- packet.  So while a statistic runs, a frame can wait until a tap of its packet has read its
-- header.  Wireshark's API.
--
-- A frame:
--   no dissector accepts it ───► NOTED ────► the tap counts it, and reports what may be a message
--   its id is not known, or ───► DEFERRED ─► the tap dissects it, unless it is no data frame
--   whether it is remote
--
-- Without a deferral, a wrapper in front of SocketCAN reads all headers (host.socketcan).  Frames
-- that are shown cannot be deferred, because a tap has no tree.  So:
--
--   none ──allow──► is_undecided ──decide: nothing is shown──► defers, and the wrapper ends
--    ▲                   │
--    └──── decide: a tree or columns are shown

local can_id = require "yapp.wire.can_id"
local frame_key = require "yapp.base.frame_key"
local records = require "yapp.reading.records"
local socketcan = require "yapp.host.socketcan"

local M = {}

local number_of = frame_key.number

local Deferral = {}
Deferral.__index = Deferral

--- Make the deferral of one plugin.
-- reading  a reading.reading
-- builder  a show.tree: whether anything is shown
-- buses    a host.buses
-- dissect  function(tvb, pinfo, tree, id, accepts_all, length), of host.can
function M.new(reading, builder, buses, dissect)
  return setmetatable({
    reading = reading,
    builder = builder,
    buses = buses,
    dissect = dissect,
    on_note = false, -- function() while a statistic runs, see Deferral:open
    is_undecided = false, -- whether frames may be deferred, see Deferral:decide
    defers = false, -- whether they are
    -- The frame that waits:
    number = false, -- of its packet, or false
    offset = 0, -- of its data in the packet
    captured = 0, -- captured bytes of it; length = number of bytes on the bus
    length = 0,
    deferred = false, -- { id = nil if it is not known, accepts_all }; false if it is only noted
    -- Frames whose header a tap has read, since the statistic began:
    can = 0, -- all of them
    extended = 0, -- extended data frames
  }, Deferral)
end

--- Forget the capture file.
function Deferral:reset()
  self.is_undecided, self.defers, self.number = false, false, false
end

--- Begin to note frames: a statistic begins, and its tap of all packets calls Deferral:on_header.
-- on_note  function(), called when a frame is noted
function Deferral:open(on_note)
  self.on_note = on_note
  self:reset_counts()
end

--- End to note frames.
function Deferral:close()
  self.on_note, self.number = false, false
end

--- Count anew.
function Deferral:reset_counts()
  self.can, self.extended = 0, 0
end

--- Allow to defer frames: this is tshark's only pass, and a tap sees every packet.
function Deferral:allow()
  self.is_undecided = true
end

--- Decide whether frames are deferred, once it is known whether anything is shown.
-- wants  of Tree:wants, nil if it is not known yet
function Deferral:decide(wants)
  if not (self.is_undecided and wants) then return end
  self.is_undecided, self.defers = false, not (wants.tree or wants.columns)
  if self.defers then socketcan.unwrap() end
end

--- Note a frame that no dissector has accepted yet.
-- returns  whether a tap of its packet will read its header
function Deferral:note(tvb, pinfo)
  if not (self.on_note and socketcan.is_record(tvb, pinfo)) then return false end
  self.number, self.offset, self.deferred = pinfo.number, tvb:offset(), false
  self.captured, self.length = tvb:len(), tvb:reported_len()
  self.on_note()
  return true
end

--- Defer a frame if that is possible.
-- id           29-bit CAN id, nil if it is not known
-- accepts_all  whether the user says that every extended frame is YAPP
-- returns      whether the tap of its packet will dissect it
function Deferral:defer(tvb, pinfo, tree, id, accepts_all)
  if self.is_undecided then -- asked now: the tap has no tree
    self:decide(self.builder:wants(tree, pinfo, false))
  end
  if not (self.defers and self:note(tvb, pinfo)) then return false end
  self.deferred = { id = id, accepts_all = accepts_all }
  return true
end

-- Return the record of a frame that was noted.
local function new_frame(self, tvb, pinfo, id)
  local frame, number = records.new_can_frame(), pinfo.number
  frame.key, frame.number = number * frame_key.PACKET + self.offset, number
  frame.time = self.buses:time(pinfo)
  frame.can_id = can_id.fields[id]
  frame.seq = frame.can_id.seq
  frame.data, frame.reported = tvb:raw(self.offset, self.captured), self.length
  frame.bus = self.buses.bus_is_per_packet and self.buses.of(number, self.offset, pinfo) or false
  return frame
end

--- Go on with the frame that waits, if it is of this packet.  A tap of all packets calls this while
-- `number` is set.
-- tvb  of the packet
function Deferral:on_header(pinfo, tvb)
  local number, deferred = self.number, self.deferred
  self.number, self.deferred = false, false
  if number ~= pinfo.number then return end
  local offset, captured = self.offset, self.captured
  local id = socketcan.id_before(tvb, pinfo, offset, self.length, deferred and deferred.id)
  self.can = self.can + 1
  if not id then return end
  self.extended = self.extended + 1
  if deferred then
    local data = tvb(offset, captured):tvb()
    self.dissect(data, pinfo, nil, id, deferred.accepts_all, self.length)
  elseif captured > 0 and number_of(self.reading.accepted_key) ~= number then
    -- Decode As may have accepted a frame that was noted when the table of ids refused it.
    self.reading:report_undissected(new_frame(self, tvb, pinfo, id))
  end
end

return M
]=])
module("yapp.host.ports", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The ports of servers of YAPP.  Wireshark's API.
--
-- A client sends from a port that its system picks.  If another protocol has that port, Wireshark
-- hands it the packets, and the heuristics never see them:
--
--   10.0.0.2:44818 -> 10.0.0.9:14550   EtherNet/IP has 44818; Wireshark asks who has 14550 first
--
-- So once YAPP is found in a conversation, the lower port looks for YAPP, too, unless another
-- protocol has it.  Packets whose other port no protocol has are left to the heuristics.

local M = {}

local TCP = 2 -- pinfo.port_type
local TABLES = { [true] = DissectorTable.get("tcp.port"), [false] = DissectorTable.get("udp.port") }

local taken = {} -- list of { table of dissectors, port }
local own -- Proto

--- Use a protocol from now on.
-- proto  that looks for YAPP, and leaves what is none
function M.use(proto)
  own = proto
end

--- Take the server's port of a conversation.
function M.take(is_tcp, port)
  local ports = TABLES[is_tcp]
  if ports:get_dissector(port) then return end -- it may be ours already
  ports:add(port, own)
  taken[#taken + 1] = { ports, port }
end

--- Return whether another protocol has the client's port of a packet.
function M.is_of_others(pinfo)
  local client = math.max(pinfo.src_port, pinfo.dst_port)
  local ports = pinfo.port_type == TCP and TABLES[true] or TABLES[false]
  return ports:get_dissector(client) ~= nil
end

--- Give back all ports, but those that the user has given to another protocol since.
function M.give_back()
  for _, row in ipairs(taken) do
    local ports, port = row[1], row[2]
    if tostring(ports:get_dissector(port)) == own.name then ports:remove(port, own) end
  end
  taken = {}
end

return M
]=])
module("yapp.host.preferences", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The preferences: their names and texts, and the meaning of their values.  Wireshark's API.

local input = require "yapp.base.input"

local M = {}

local FIRST_DLT, LAST_DLT = 147, 162 -- DLT_USER0 .. DLT_USER15

--- Show problems to the user: in one dialog in Wireshark, on stderr in tshark.
-- texts  list
function M.complain(texts)
  if #texts == 0 then return end
  if gui_enabled() and report_failure then
    report_failure("YAPP: " .. table.concat(texts, "\n"))
    return
  end
  for _, text in ipairs(texts) do io.stderr:write("yapp: " .. text .. "\n") end
end

local is_said = {} -- by text

--- Show errors in the preferences, each text once, although they are read with each file.
-- texts  list
function M.complain_once(texts)
  local new = {}
  for _, text in ipairs(texts) do
    if not is_said[text] then new[#new + 1] = "preferences: " .. text end
    is_said[text] = true
  end
  M.complain(new)
end

--- Give a protocol its preferences.
-- proto      Proto
-- catalogue  compiled
-- field_kinds  the module
-- max_id     the highest message ID
function M.define(proto, catalogue, field_kinds, max_id)
  local prefs, periods = proto.prefs, {}
  for _, message in ipairs(catalogue.messages) do
    local title, id, period = message.title, ("0x%x"):format(message.id), message.every
    local about = ("The IDs that carry %s; %s by default, which Wireshark shows as %d. Change " ..
      "it if a controller has other IDs, or if several controllers share a bus: %s-0x%x."):format(
      title, id, message.id, id, message.id + 3)
    local label = ("%s message IDs (%s = %d)"):format(title, id, message.id)
    prefs[message.name .. "_ids"] = Pref.range(label, id, about, max_id)
    if period then periods[#periods + 1] = ("%s %g s"):format(title, period) end
  end
  prefs.sources = Pref.string("Names of sources", "",
    "What to call an ID, everywhere or on one bus, and which message it carries: " ..
    "0x210=motor:left_fore, can1/0x210=motor:right_fore, 0x212=left_tail. Several IDs have " ..
    "one name with a plus between them: can0/0x000+0x200+0x210=left. A range names each of its " ..
    "IDs: can0/0x210-0x213=motor:M1..M4. A bus alone names all of " ..
    "its IDs: can2=tail. An interface without a name is if0 or if1, its number in the file.")
  prefs.messages = Pref.string("File with your own messages", "",
    "A Lua file like taurus_fields.lua. Its messages come after those of yapp_messages.lua in " ..
    "the personal configuration folder, which needs no setting. It is read when Wireshark " ..
    "starts, from the default profile's setting: a change takes effect at the next start. For " ..
    "one run alone set the environment variable YAPP_MESSAGES.")
  prefs.hide_source = Pref.bool("Leave the source out of Info", false,
    "Switch it on if a column shows yapp.source, as in the profile YAPP: Info and the tree then " ..
    "say Motor Data instead of Motor Data left. A message with a fault or a warning keeps its " ..
    "source, for the expert information.")
  prefs.hide_values = Pref.bool("Leave values out of Info that have columns", false,
    "Switch it on if columns show speed, voltage and current, as in the profile YAPP: Info then " ..
    "has the other values of Motor Data.")
  prefs.late = Pref.string("Report a gap longer than ... periods", "2.5",
    "A longer gap between two messages of a source is a warning, yapp.late. At 2.5 a single " ..
    "lost message causes no warning. Periods: " .. table.concat(periods, ", ") .. ".")
  prefs.all_extended = Pref.bool("All extended CAN frames are YAPP", false,
    "Switch it on for a bus that carries nothing but YAPP: you see unknown IDs, other YAPP CTL " ..
    "values and malformed frames, too. By default the plugin takes only what is surely YAPP.")
  prefs.search_all = Pref.bool("Look for YAPP in all TCP, UDP and USB traffic", false,
    "The plugin finds YAPP in TCP, UDP and USB by itself in live captures, and in files whose " ..
    "first 64 KB have a header. Switch it on if YAPP comes later in your files. It costs " ..
    "about 1 µs for each packet that no other dissector takes.")
  prefs.divisor = Pref.enum("Compressed floats divide by", field_kinds.MAPPING,
    "2^N - 6 is what the devices send. Choose 2^N - 5 only to reproduce the figures printed " ..
    "in the worked examples of the vendor's document (0.4975 A, 749.26 RPM).",
    {
      { 1, "2^N - 6 (mapping)", field_kinds.MAPPING },
      { 2, "2^N - 5 (worked examples)", field_kinds.WORKED_EXAMPLES },
    })
  prefs.user_dlt = Pref.range("Link types that carry a serial stream", "",
    "147 to 162, the numbers of DLT_USER0 to DLT_USER15. Set it for serial captures with such a " ..
    "link type, if Wireshark's DLT_USER table is not convenient: this preference overrides that " ..
    "table. Usually empty.",
    LAST_DLT)
end

--- Return the numbers of a range, each once, in its order.
-- text  as Wireshark writes a range, "528,768-771": it refuses all else
function M.range(text)
  local numbers, is_there = {}, {}
  for first, last in text:gmatch("(%d+)%-?(%d*)") do
    for number = tonumber(first), tonumber(last) or tonumber(first) do
      if not is_there[number] then numbers[#numbers + 1] = number end
      is_there[number] = true
    end
  end
  return numbers
end

--- Return how many periods a gap may last, a number above 0; and a list of errors.
-- text  of the preference; if it is not a number above 0, use 2.5
function M.late(text)
  local late = input.decimal(input.trim(text))
  if late and late > 0 then return late, {} end
  local problem = 'yapp.late: no number above 0 in "%s"; it is 2.5 until you change it'
  return 2.5, { problem:format(text) }
end

local before_us = {} -- [encapsulation] = its dissector before it was ours, or false

--- Give user link types to the serial dissector.  Give back those that the preference no longer
-- names.
-- text     of the preference
-- proto    of the serial dissector
-- returns  a list of errors
function M.take_link_types(text, proto)
  local encapsulations = DissectorTable.get("wtap_encap")
  local wanted, other = {}, nil
  for _, dlt in ipairs(M.range(text)) do
    if dlt < FIRST_DLT then
      other = other or dlt
    else
      wanted[wtap.USER0 + dlt - FIRST_DLT] = true
    end
  end
  for encapsulation in pairs(wanted) do
    if before_us[encapsulation] == nil then
      before_us[encapsulation] = encapsulations:get_dissector(encapsulation) or false
      encapsulations:add(encapsulation, proto)
    end
  end
  for encapsulation, before in pairs(before_us) do
    if not wanted[encapsulation] then
      encapsulations:remove(encapsulation, proto)
      if before then encapsulations:add(encapsulation, before) end
      before_us[encapsulation] = nil
    end
  end
  local problem = "yapp.user_dlt: link type %d is no DLT_USER; those are 147 to 162"
  return other and { problem:format(other) } or {}
end

return M
]=])
module("yapp.host.serial", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The dissector of YAPP in byte streams and datagrams: UART captures, raw dumps, TCP and UDP.  It
-- hands each packet to the reading, and the result to the view.  Wireshark's API.

local frame_key = require "yapp.base.frame_key"
local lines = require "yapp.serial.lines"
local ports = require "yapp.host.ports"
local senders = require "yapp.serial.senders"
local tcp = require "yapp.host.tcp"
local usb = require "yapp.serial.usb"

local M = {}

local PACKET = frame_key.PACKET
local INSIDE = PACKET / 2 -- offset of what TLS found in a packet

local Dissector = {}
Dissector.__index = Dissector

--- Make the dissector.
-- reading     a reading.reading
-- view        a show.packet
-- builder     a show.tree
-- buses       a host.buses
-- tcp_header  Proto that reads TCP's headers
function M.new(reading, view, builder, buses, tcp_header)
  return setmetatable({
    reading = reading,
    view = view,
    builder = builder,
    buses = buses,
    tcp_header = tcp_header,
    in_pieces = {}, -- conversations, see Dissector:notes
    conversations = {}, -- those that the first bytes of the file have, see Dissector:scan
    inside = false, -- what TLS found in the current packet, see put_inside
    usb = false, -- of serial.usb
  }, Dissector)
end

--- Forget the capture file.
function Dissector:reset()
  self.in_pieces, self.inside, self.usb, self.conversations = {}, false, usb.new(), {}
  tcp.stop()
  ports.give_back()
end

--- Look at the first bytes of the capture file, which may have frames.
function Dissector:scan(head)
  self.reading.lines.senders:scan(head)
  self.conversations = senders.conversations(head)
  self.reading.lines:await(self.conversations)
  for _, one in ipairs(self.conversations) do ports.take(one.is_tcp, one.port) end
  if self.reading:is_yapp(head) then self:watch_tcp() end
end

-- Return the line of a packet, and whether it is known where the packet was captured.
local function line_of(self, pinfo)
  local kind, from, bus, is_bus_known, time = pinfo.port_type, tostring(pinfo.src), nil, true, nil
  if not lines.is_ip(kind, from) then
    bus, is_bus_known = self.buses.of(pinfo.number, 0, pinfo)
  elseif not pinfo.visited then
    time = self.buses:time(pinfo)
  end
  local line = self.reading.lines:of(kind, from, pinfo.src_port, tostring(pinfo.dst),
    pinfo.dst_port, bus, time)
  return line, is_bus_known
end

-- Make the record of a packet, or of a part of one.
-- line    see serial.lines
-- offset  of its bytes in the packet
-- length  number of bytes that it had
-- wants   of Tree:wants
local function new_packet(self, line, pinfo, offset, bytes, length, wants)
  local number, is_truncated = pinfo.number, length > #bytes
  return {
    key = number * PACKET + offset,
    number = number,
    time = self.buses:time(pinfo), -- seconds since the first packet
    epoch = is_truncated and pinfo.abs_ts, -- since 1970, or false
    visited = pinfo.visited,
    bytes = bytes, -- those that were captured
    length = length,
    truncated = is_truncated,
    is_datagram = line.is_datagram, -- whether it is of UDP
    is_complete = line.is_complete, -- whether it is what the framing of a raw dump found
    is_tcp = line.is_tcp,
    is_found = self.reading.found[line.trial_key], -- whether its conversation was found by content
    line = line,
    stream = line.key,
    tag = line.tag,
    bus_name = line.bus,
    seq = nil, -- of TCP, if it is known: of the first byte
    is_bus_known = true, -- whether the capture tells where it was captured
    is_only_pass = wants.is_only_pass, -- whether it is never dissected again
    wants_state = wants.state, -- whether the state of its messages is wanted
  }
end

-- Return the record of all bytes that a dissector gets.
local function whole_packet(self, tvb, pinfo, wants)
  local line, is_bus_known = line_of(self, pinfo)
  local bytes = tvb:len() > 0 and tvb:raw() or ""
  local packet = new_packet(self, line, pinfo, tvb:offset(), bytes, tvb:reported_len(), wants)
  packet.is_bus_known = is_bus_known
  return packet
end

-- Whether a packet of an unknown conversation may go on with a frame.
local function may_go_on(streams, pinfo)
  return streams:may_go_on(lines.tag(pinfo.port_type, pinfo.src_port, pinfo.dst_port))
end

--- Return whether a packet of an unknown conversation is YAPP.
function Dissector:accepts(tvb, pinfo, tree)
  if tvb:len() == 0 then return false end
  local reading, bytes = self.reading, tvb:raw()
  local streams = reading.streams
  local may_begin = streams.may_begin(bytes)
  -- Most packets are of others, and few come while a conversation is on trial.
  if not (may_begin or streams.trial_count > 0 or pinfo.visited) then return false end
  if pinfo.in_error_pkt then return false end
  if pinfo.visited then return streams:is_stored(pinfo.number * PACKET + tvb:offset()) end
  if not (may_begin and reading:may_be_yapp(bytes) or may_go_on(streams, pinfo)) then
    return false
  end
  local packet = whole_packet(self, tvb, pinfo, self.builder:wants(tree, pinfo, false))
  local is_found, is_in_pieces = reading:try_packet(packet)
  local is_tcp, port = packet.is_tcp, math.min(pinfo.src_port, pinfo.dst_port)
  if is_in_pieces then table.insert(self.in_pieces, { is_tcp = is_tcp, port = port }) end
  if is_found then ports.take(is_tcp, port) end
  return is_found
end

--- Return notes on conversations whose packets hold no whole header: a list of texts.
function Dissector:notes()
  if not self.in_pieces[1] then return {} end
  local text = "YAPP came in pieces without a whole header: to list its packets, add %s"
  return { text:format(table.concat(senders.options(self.in_pieces), " ")) }
end

--- Return the options of tshark that decode the conversations that another protocol took, of those
-- in the first bytes of the file: a list.
function Dissector:options()
  return senders.options(self.reading.lines:unread(self.conversations))
end

--- Whether packets of a serial line came.
function Dissector:has_serial()
  return self.reading.lines.has_serial
end

-- Dissect a packet; return whether it is YAPP's.
-- tvb  where its bytes are
local function dissect(self, packet, wants, tvb, pinfo, tree)
  local reading, visited = self.reading, packet.visited
  local contents = visited and reading:recall_packet(packet)
  if not visited then contents = reading:add_packet(packet) end
  if not contents then return false end
  self.view:show(packet, contents, wants, tvb, pinfo, tree)
  return true
end

-- Dissect a segment that TCP has shown.
-- tvb  with the header of TCP
local function dissect_segment(self, segment, tvb, pinfo, tree)
  local line, start = line_of(self, pinfo), segment.start
  local has_order = pinfo.visited or
    self.reading.streams:note_header(line.key, line.opposite, segment)
  line.is_direct = line.is_direct or segment.is_ours
  line.is_over = line.is_over or segment.is_end
  if segment.length == 0 or not (segment.is_ours or has_order) then return end
  local bytes, wants = "", self.builder:wants(tree, pinfo, pinfo.visited)
  if tvb:len() > start then bytes = tvb:raw(start) end
  local packet = new_packet(self, line, pinfo, tvb:offset() + start, bytes,
    tvb:reported_len() - start, wants)
  packet.seq, packet.epoch = segment.seq, segment.epoch
  if wants.tree and bytes ~= "" then tvb = tvb(start):tvb() end
  dissect(self, packet, wants, tvb, pinfo, tree)
end

-- Let a packet be what TLS found in a segment: a stream beside that of TCP.  Several records of a
-- segment have keys behind each other, behind those of TCP; they come anew on each revisit.
local function put_inside(self, packet)
  local before, bytes, number = self.inside, packet.bytes, packet.number
  local is_next = before and before.number == number and
    not (packet.visited and before.first == bytes)
  local offset = is_next and before.offset or INSIDE
  self.inside = {
    number = number,
    offset = offset + #bytes,
    first = is_next and before.first or bytes,
  }
  packet.stream, packet.key = "tls|" .. packet.stream, number * PACKET + offset
end

-- Dissect bytes in TCP.  Those of a segment are shown when TCP has shown the segment.  Others are
-- what TLS found in one, unless TCP has joined segments: but then others of the line came alone.
-- returns  whether they are YAPP's
local function dissect_in_tcp(self, tvb, pinfo, tree)
  local segment, offset = tcp.current(pinfo.number), tvb:offset()
  local is_direct = segment and offset == segment.offset or not segment and offset > 0
  is_direct = is_direct or line_of(self, pinfo).is_direct
  if segment and is_direct then
    segment.is_ours = true -- these bytes may be of several: dissect_segment shows it
    return true
  end
  local wants = self.builder:wants(tree, pinfo, pinfo.visited)
  local packet = whole_packet(self, tvb, pinfo, wants)
  if is_direct then
    self:watch_tcp()
  else
    put_inside(self, packet) -- TLS needs no watch, and would lose the records that came before
  end
  return dissect(self, packet, wants, tvb, pinfo, tree)
end

--- Watch TCP, to know the sequence numbers from the first segment on.
function Dissector:watch_tcp()
  tcp.watch(self.tcp_header, function(...) dissect_segment(self, ...) end)
end

--- Dissect the bytes of a packet.
-- returns  the number of bytes that are ours
function Dissector:dissect(tvb, pinfo, tree)
  local size = tvb:len()
  -- An ICMP error only quotes what was sent before.
  if size == 0 or pinfo.in_error_pkt then return 0 end
  if pinfo.port_type == lines.TCP then
    return dissect_in_tcp(self, tvb, pinfo, tree) and size or 0
  end
  local wants = self.builder:wants(tree, pinfo, pinfo.visited)
  local packet = whole_packet(self, tvb, pinfo, wants)
  return dissect(self, packet, wants, tvb, pinfo, tree) and size or 0
end

-- Return where the bytes are that an adapter carries, less its status.
local function part_tvb(part, tvb)
  if part.has_status then return ByteArray.new(part.bytes, true):tvb("Serial line") end
  return tvb(part.offset):tvb()
end

-- Return what a packet of USB has of a line that has YAPP or may have it, see Usb:read, and the
-- line; nil for nothing.
local function part_of_line(self, kind, raw)
  local reading = self.reading
  local streams = reading.streams
  local is_idle = streams.trial_count == 0 and not next(reading.found)
  if is_idle and usb.is_of_others(kind, raw) then return nil end
  local part = self.usb:read(kind, raw)
  if not part or part.bytes == "" then return nil end
  local line = reading.lines:of_adapter(part.line)
  local may_be_yapp = reading.found[line.trial_key] or streams.may_begin(part.bytes) or
    streams:may_go_on(line.tag)
  if may_be_yapp then return part, line end
end

--- Dissect a packet of USB that Wireshark has shown, if it has bytes of a serial line with YAPP.
-- kind  of serial.usb
function Dissector:dissect_usb(kind, tvb, pinfo, tree)
  local part, line = part_of_line(self, kind, tvb:raw())
  if not part then return end
  local reading, wants = self.reading, self.builder:wants(tree, pinfo, pinfo.visited)
  local length = part.truncated and #part.bytes + 1 or #part.bytes
  local packet = new_packet(self, line, pinfo, part.offset, part.bytes, length, wants)
  local is_found = reading.found[line.trial_key] or
    not packet.visited and reading:try_packet(packet)
  if is_found then
    dissect(self, packet, wants, wants.tree and part_tvb(part, tvb), pinfo, tree)
  end
end

--- Dissect bytes of a raw dump that are of no frame.
-- returns  the number of bytes that are ours
function Dissector:skipped(tvb, pinfo, tree)
  local size = tvb:len()
  if size > 0 then
    local wants = self.builder:wants(tree, pinfo, pinfo.visited)
    local packet = whole_packet(self, tvb, pinfo, wants)
    self.view:show(packet, self.reading:add_skipped(packet), wants, tvb, pinfo, tree)
  end
  return size
end

return M
]=])
module("yapp.host.socketcan", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- Facts about the current packet that SocketCAN does not hand on to our dissector: the CAN id of a
-- frame that comes by Decode As or a heuristic; whether a frame is a remote frame; the values of
-- other dissectors' fields.  Wireshark's API.
--
-- SocketCAN hands on the data alone.  It finds our messages in its table of ids, where
-- pinfo.match_uint is the id.  For all other frames a wrapper in front of SocketCAN reads the
-- header.  That is exact on every pass, but costs a name in frame.protocols and about 3 µs a CAN
-- frame.  So it begins only with Decode As, yapp.all_extended or a statistic.  If only statistics
-- are wanted, it ends: a tap, which sees the whole packet, reads the headers that are needed.

local M = {}

local EXTENDED, MASK = 0x80000000, 0x20000000
local HEADER = 8 -- bytes that have the id
local MAX_THROWN = 24
local NO_COLUMN = "(info)" -- the text of a column if there are no columns

-- The latest header that was read: { number = of its packet, can_id = 29 bits, nil if it is not of
-- an extended data frame }.
local header = {}

-- Fields ------------------------------------------------------------------------------------------

-- Read the values of the wanted fields alone: on 4.0 the value of an item without bytes, such as a
-- packet comment, throws past Lua.
local function by_name(names, ok, ...)
  local found = {}
  for _, info in ipairs(ok and { ... } or {}) do
    if names[info.name] then found[info.name] = info.value end
  end
  return found
end

--- Return the wanted fields that the tree has so far; none if no tree is built.
-- names    { [filter name] = true } of the wanted fields
-- returns  { [filter name] = value }
function M.fields_of(names)
  return by_name(names, pcall(all_field_infos))
end

local NAMES = { ["can.id"] = true, ["can.flags.xtd"] = true, ["can.flags.rtr"] = true }

local function is_true(value) return value == true or value == 1 end

--- Return the id of the current frame, which came by Decode As or by the heuristics.
-- returns  29-bit id; nil for what is no extended data frame; nil and true if nothing says it
function M.find_id(pinfo)
  if header.number == pinfo.number then return header.can_id end
  local fields = M.fields_of(NAMES)
  local id, extended = fields["can.id"], fields["can.flags.xtd"]
  if id ~= nil and extended ~= nil then return is_true(extended) and id % MASK or nil end
  -- "Ext. ID: 138428416 (0x8404000), Length: 8", as SocketCAN leaves it in the Info column.
  local text = tostring(pinfo.cols.info)
  if not (text:find("ID: ", 1, true) or text:find("^ERR")) then return nil, true end
  return tonumber(text:match("Ext%. ID: (%d+)"))
end

--- Return whether a header, a field or a column says that a frame of zeros is a remote frame:
-- remote frames have no data, but captures give them zeros.  Return nil if nothing says it.
function M.is_remote(pinfo)
  if header.number == pinfo.number then return header.can_id == nil end
  local rtr = M.fields_of(NAMES)["can.flags.rtr"]
  if rtr ~= nil then return is_true(rtr) end
  local info = tostring(pinfo.cols.info)
  if info == NO_COLUMN then return nil end
  return tostring(pinfo.cols.protocol) ~= "CANFD" and info:find("Remote", 1, true) ~= nil
end

--- Forget the capture file.
function M.init()
  header = {}
end

-- The header in front -----------------------------------------------------------------------------

-- Return the 29-bit id of the first word of a SocketCAN record, nil for no extended data frame.
-- Above the id it has three bits: extended, remote, error.
local function data_id(word)
  return word >= EXTENDED and word < EXTENDED + MASK and word % MASK or nil
end

-- The same of a record; big endian in its own encapsulation (unless a preference says otherwise),
-- host order in cooked captures.
local function header_id(tvb, is_little)
  if tvb:len() < HEADER then return nil end
  return data_id(is_little and tvb(0, 4):le_uint() or tvb(0, 4):uint())
end

--- Return whether the data of a CAN frame may be that of a SocketCAN record, which fills its packet
-- to the end.  In other protocols, several CAN frames may lie in a packet.
function M.is_record(tvb, pinfo)
  local rest = pinfo.len - tvb:offset() -- nothing where a remote frame has its header alone
  return rest >= 0 and rest <= 8 or rest == 64 or rest == tvb:reported_len()
end

--- Return the id that the header in front of a record's data has.
-- tvb       of the whole packet
-- offset    of the data; length = on the bus
-- known_id  the id, nil if it is not known: it proves the header and its byte order
-- returns   29-bit id; nil for what is no extended data frame; known_id if this is no header
function M.id_before(tvb, pinfo, offset, length, known_id)
  local id = known_id
  local has_room = offset >= HEADER and offset <= tvb:len()
  if has_room and tvb(offset - 4, 1):uint() == length then
    local start = tvb(offset - HEADER, 4)
    local word, other = start:uint(), start:le_uint()
    -- Big endian are SocketCAN's own encapsulation and PPI; little endian cooked captures and logs.
    local is_big = offset == HEADER and not get_preference("can.byte_swap") or offset == 2 * HEADER
    if not is_big then word, other = other, word end
    if known_id and word % MASK ~= known_id then word = other end
    if not known_id or word % MASK == known_id then id = data_id(word) end
  end
  header.number, header.can_id = pinfo.number, id
  return id
end

-- How many calls for truncated frames did not return: at bytes that are not there a C dissector
-- throws past Lua, which costs 2 of Lua's 200 nested calls for good.
local thrown = 0

-- Hand a frame on to SocketCAN.  Of a truncated frame SocketCAN sees only the captured bytes, if
-- the frame cannot be YAPP or if dissectors have thrown too often.
local function hand_on(inner, can_id, tvb, pinfo, tree)
  local length = tvb:len()
  if length < HEADER then return 0 end
  local is_complete = length == tvb:reported_len()
  if not is_complete and (not can_id or thrown >= MAX_THROWN) then
    tvb, is_complete = tvb(0, length):tvb(), true
  end
  if not is_complete then thrown = thrown + 1 end
  -- If this fails, Wireshark has added an item that says so.
  local ok, taken = pcall(inner.call, inner, tvb, pinfo, tree)
  if not is_complete then thrown = thrown - 1 end
  return ok and taken or length
end

-- Where CAN frames come from: table, value in it, and whether the id is in the host's order, which
-- is little endian on every machine of today.
local ORIGINS = {
  { "wtap_encap", wtap.SOCKETCAN, false },
  { "sll.ltype", 0x0C, true },
  { "sll.ltype", 0x0D, true },
}
local origins -- [value] = { inner = dissector, is_little, dissectors = its table }, while it reads

--- Read the CAN header of every frame from now on.
-- proto          a Proto for the wrapper
-- is_first_pass  whether only frames that are new are read: the first one that is not ends it
function M.wrap(proto, is_first_pass)
  if origins then return end
  origins = {}
  function proto.dissector(tvb, pinfo, tree)
    local value = pinfo.match_uint
    local origin = origins[value]
    if not origin then return 0 end
    -- The user says that a little endian machine wrote the records in its own byte order.
    local is_swapped = value == wtap.SOCKETCAN and get_preference("can.byte_swap")
    local can_id = header_id(tvb, origin.is_little or is_swapped)
    header.number = pinfo.number
    header.can_id = can_id
    if is_first_pass and pinfo.visited then M.unwrap() end
    return hand_on(origin.inner, can_id, tvb, pinfo, tree)
  end
  for _, row in ipairs(ORIGINS) do
    local dissectors, value = DissectorTable.get(row[1]), row[2]
    local inner = dissectors:get_dissector(value)
    if inner then
      origins[value] = { inner = inner, is_little = row[3], dissectors = dissectors }
      dissectors:add(value, proto)
    end
  end
end

--- Read no more headers.
function M.unwrap()
  for value, origin in pairs(origins or {}) do origin.dissectors:add(value, origin.inner) end
  origins = nil
end

return M
]=])
module("yapp.host.stamps", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- Whether the first packets of a capture file have different time stamps.  Pure Lua.
--
-- A recorder without a clock gives all packets one stamp.  So packets with the stamp of the first
-- one may have come at once, or at any time, until another stamp is known.

local M = {}

local byte, sub = string.byte, string.sub

-- Return a number of four bytes.
local function number_at(head, index, is_little)
  local a, b, c, d = byte(head, index, index + 3)
  if is_little then a, b, c, d = d, c, b, a end
  return ((a * 256 + b) * 256 + c) * 256 + d
end

-- Return an iterator over the stamps, as their bytes, of the packets of pcap.
local function pcap_stamps(head, is_little)
  local index = 25
  return function()
    if index + 15 > #head then return nil end
    local stamp = sub(head, index, index + 7)
    index = index + 16 + number_at(head, index + 8, is_little)
    return stamp
  end
end

local PACKET = 6 -- the kind of a block

-- Return the same of the packets of the first interface of pcapng: others may have other units.
local function pcapng_stamps(head)
  local is_little = sub(head, 9, 12) == "\77\60\43\26"
  local index, interface = 1, nil
  return function()
    while index + 19 <= #head do
      local at, kind = index, number_at(head, index, is_little)
      local length = number_at(head, index + 4, is_little)
      if length < 12 then return nil end
      index = index + length + -length % 4
      if kind == PACKET then
        interface = interface or sub(head, at + 8, at + 11)
        if sub(head, at + 8, at + 11) == interface then return sub(head, at + 12, at + 19) end
      end
    end
  end
end

local READERS = {
  ["\212\195\178\161"] = pcap_stamps,
  ["\77\60\178\161"] = pcap_stamps,
  ["\161\178\195\212"] = pcap_stamps,
  ["\161\178\60\77"] = pcap_stamps,
  ["\10\13\13\10"] = pcapng_stamps,
}

--- Return whether two packets have different stamps; nil for a file of another format.
-- head  the first bytes of the file
function M.differ(head)
  local magic = sub(head, 1, 4)
  local reader, first = READERS[magic], nil
  if not reader then return nil end
  for stamp in reader(head, byte(magic) > 64 and byte(magic) ~= 161) do
    first = first or stamp
    if stamp ~= first then return true end
  end
  return false
end

return M
]=])
module("yapp.host.tcp", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The headers of TCP segments.  Wireshark's API.
--
-- Wireshark's TCP hands on bytes without their sequence numbers.  Which segments it keeps to itself
-- or joins depends on its version and preferences.  So a watch in front of TCP reads the header,
-- and hands on the segment when TCP has shown it.  That costs a name in frame.protocols and about 1
-- µs a segment, so it runs only in captures with YAPP on TCP.

local band = require "yapp.base.bits".band

local M = {}

local TCP = 6 -- IP protocol
local HEADER = 20
local FIN, SYN, RST, ACK = 1, 2, 4, 16 -- flags

-- A dissector of another protocol may throw past Lua at a truncated segment.  Each time Lua loses
-- one of its 200 nested calls for good.  So the watch ends after this many.
local MAX_THROWN = 24

local protocols, tcp = DissectorTable.get("ip.proto"), Dissector.get("tcp")
-- When Wireshark reloads its Lua plugins, the watch that was there takes TCP away with it.
if not protocols:get_dissector(TCP) then protocols:add(TCP, tcp) end
local is_watching, thrown = false, 0
local segment, inside -- that TCP is dissecting, nil for none; number of the packet that TCP has

-- Read a header; nil if it is not there or if an ICMP error only quotes it.
local function read(tvb, pinfo)
  if tvb:len() < HEADER or pinfo.in_error_pkt then return nil end
  local seq, ack, size, flags = Struct.unpack(">I4I4BB", tvb:raw(4, 10))
  local start, is_syn = band(size, 0xF0) / 4, band(flags, SYN) ~= 0
  if start < HEADER or start > tvb:len() then return nil end
  return {
    offset = tvb:offset() + start,
    start = start,
    length = band(flags, RST) == 0 and tvb:reported_len() - start or 0,
    seq = (seq + (is_syn and 1 or 0)) % 0x100000000,
    ack = band(flags, ACK) ~= 0 and ack or nil,
    is_syn = is_syn,
    is_end = band(flags, FIN + RST) ~= 0,
    number = pinfo.number,
    epoch = pinfo.abs_ts,
    is_ours = false,
  }
end

--- End the watch.
function M.stop()
  if is_watching then protocols:add(TCP, tcp) end
  is_watching, inside, segment = false, nil, nil
end

--- Read the header of every segment from now on.
-- proto    Proto for the watch
-- hand_on  function(segment, tvb, pinfo, tree), called when TCP has shown a segment; see M.current
function M.watch(proto, hand_on)
  if is_watching or thrown >= MAX_THROWN then return end
  is_watching = true
  function proto.dissector(tvb, pinfo, tree)
    if inside and inside ~= pinfo.number then
      segment, thrown = nil, thrown + 1
      if thrown >= MAX_THROWN then M.stop() end
    end
    local outer, current = segment, read(tvb, pinfo)
    segment, inside = current, pinfo.number
    local ok, length = pcall(tcp.call, tcp, tvb, pinfo, tree)
    segment, inside = outer, outer and inside
    if current then hand_on(current, tvb, pinfo, tree) end
    return ok and length or tvb:len()
  end
  protocols:add(TCP, proto)
end

--- Return the segment that TCP is dissecting, nil for none.
-- number   of the packet that is dissected
-- returns  {
--   start    offset of its bytes, behind TCP's header; offset = in the packet
--   length   number of data bytes that were sent; 0 for a reset
--   seq      sequence number of the first one
--   ack      sequence number that it acknowledges, or nil
--   is_syn   whether it begins a connection; is_end = whether it ends one
--   number, epoch  of its packet: epoch = seconds since 1970
--   is_ours  to be set if TCP hands it to YAPP }
function M.current(number)
  return inside == number and segment or nil -- else a dissector threw past Lua
end

return M
]=])
module("yapp.host.usb", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The packets of USB.  Wireshark's API.
--
-- Nothing hands a serial adapter's bytes to YAPP: usb.bulk takes no Decode As, and for FTDI's
-- adapters Wireshark asks its own dissector alone.  So a watch in front of USB hands on each packet
-- when Wireshark has shown it.  It costs about 2 µs a packet, so it runs only where YAPP is looked
-- for.

local M = {}

-- The kinds of packets: encapsulation of Wireshark, name of serial.usb.
local KINDS = {
  { wtap.USB_LINUX, "usbmon" },
  { wtap.USB_LINUX_MMAPPED, "usbmon_mapped" },
  { wtap.USBPCAP, "usbpcap" },
}

-- A dissector of Wireshark's may throw past Lua at damaged or truncated packets.  Each time Lua
-- loses one of its 200 nested calls for good.  So the watch ends after this many.
local MAX_THROWN = 24

local encapsulations = DissectorTable.get("wtap_encap")
local inner, kind_of = {}, {} -- by encapsulation: its dissector, its kind
local is_watching, is_ended, thrown = false, false, 0

local function stop()
  is_ended = true
  for encapsulation, dissector in pairs(inner) do encapsulations:add(encapsulation, dissector) end
end

-- Let Wireshark dissect a packet.
local function show(dissector, tvb, pinfo, tree)
  thrown = thrown + 1
  if thrown == MAX_THROWN and not is_ended then stop() end
  local ok, length = pcall(dissector.call, dissector, tvb, pinfo, tree)
  thrown = thrown - 1
  return ok and length or tvb:len()
end

--- Return notes on packets that were not examined: a list of texts.
function M.notes()
  if not is_ended then return {} end
  local text = "Wireshark failed at %d USB packets: those behind them were not searched"
  return { text:format(MAX_THROWN) }
end

--- Hand on each packet of USB from now on.  Call it once or more.
-- proto    Proto for the watch
-- hand_on  function(kind, tvb, pinfo, tree): kind of serial.usb
function M.watch(proto, hand_on)
  if is_watching then return end
  is_watching = true
  function proto.dissector(tvb, pinfo, tree)
    local encapsulation = pinfo.match_uint
    local length = show(inner[encapsulation], tvb, pinfo, tree)
    hand_on(kind_of[encapsulation], tvb, pinfo, tree)
    return length
  end
  for _, row in ipairs(KINDS) do
    local encapsulation, kind = row[1], row[2]
    local dissector = encapsulation and encapsulations:get_dissector(encapsulation)
    if dissector then
      inner[encapsulation], kind_of[encapsulation] = dissector, kind
      encapsulations:add(encapsulation, proto)
    end
  end
end

return M
]=])
module("yapp.message.binary", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The numbers in the bytes of a payload, little endian ("YAPP Data Types", "Time"): integers of any
-- size, IEEE 754, times; and their shortest texts.  Pure Lua.

local M = {}

local abs, floor = math.abs, math.floor
local byte, format = string.byte, string.format

--- Return the number of so many bytes, rounded to a double.
-- index  in the payload, 1-based
function M.count(payload, index, size)
  local count = size > 6 and 0.0 or 0 -- COMPAT 5.4: integers of eight bytes wrap around
  for i = index + size - 1, index, -1 do
    count = count * 0x100 + byte(payload, i)
  end
  return count
end

--- Return an IEEE 754 number.
-- digits  bits of its mantissa: 23 of four bytes, 52 of eight
function M.ieee(payload, index, size, digits)
  local bits_of_exponent = 8 * size - 1 - digits
  local a, b = byte(payload, index + size - 2, index + size - 1)
  local high = 2 ^ (15 - bits_of_exponent) -- the two highest bytes: sign, exponent, digits
  local top = b % 0x80 * 0x100 + a
  local exponent = floor(top / high)
  local mantissa = top % high * 2 ^ (digits - 15 + bits_of_exponent) +
    M.count(payload, index, size - 2)
  local sign, highest = b >= 0x80 and -1 or 1, 2 ^ bits_of_exponent - 1
  if exponent == highest then return mantissa == 0 and sign * math.huge or 0 / 0 end
  local bias = (highest - 1) / 2 + digits
  if exponent == 0 then return sign * (mantissa * 2 ^ (1 - bias)) end
  return sign * (mantissa + 2 ^ digits) * 2 ^ (exponent - bias)
end

local BILLION = 1000000000

-- Divide an integer of eight bytes by 10^9.
-- returns  the quotient, and the rest, of the same sign
local function divide(payload, index, is_signed)
  local a, b, c, d, e, f, g, h = byte(payload, index, index + 7)
  if h == 0 and g < 0x20 then -- the usual one: a double holds it
    local high = e + f * 0x100 + g * 0x10000
    local number = high * 0x100000000 + d * 0x1000000 + c * 0x10000 + b * 0x100 + a
    local rest = number % BILLION
    return (number - rest) / BILLION, rest
  end
  -- Long division, a byte a step.  The highest byte of a negative number counts as negative.
  local quotient, rest = 0, is_signed and h >= 0x80 and h - 0x100 or h
  for i = index + 6, index, -1 do
    local dividend = rest * 0x100 + byte(payload, i)
    rest = dividend % BILLION
    quotient = quotient * 0x100 + (dividend - rest) / BILLION
  end
  if quotient < 0 and rest > 0 then return quotient + 1, rest - BILLION end
  return quotient, rest
end

--- Return an integer of eight bytes: a number up to 2^53, beyond that its decimal digits.
function M.integer64(payload, index, is_signed)
  local billions, rest = divide(payload, index, is_signed)
  if abs(billions) < 9007199 then return billions * BILLION + rest end
  return format("%.0f%09.0f", billions, abs(rest))
end

--- Split a signed 64 bit count of nanoseconds exactly ("Time").
-- payload  string
-- offset   0-based
-- returns  seconds, nanoseconds; both negative, or zero, for a negative time
function M.time(payload, offset)
  return divide(payload, offset + 1, true)
end

-- Round to a number that four bytes can hold: adding and subtracting a large number rounds off the
-- digits below it.
local function to_float32(value)
  local large = 1.5 * 2 ^ -97
  if abs(value) >= 2 ^ -126 then large = value * (2 ^ 29 + 1) end
  return large - (large - value)
end

--- Return the number with the fewest digits that is equal as a float of four bytes: 0.1 for
-- 0.10000000149.
-- value  finite
function M.shortest(value)
  if value == 0 then return value end -- COMPAT 5.4: the text "-0" is an integer there
  for digits = 6, 8 do
    local short = tonumber(format("%." .. digits .. "g", value))
    if to_float32(short) == value then return short end
  end
  return tonumber(format("%.9g", value))
end

--- Return a time in seconds as a text with nine digits behind the point.
function M.seconds(seconds, nanoseconds)
  if seconds < 0 or nanoseconds < 0 then
    return format("-%d.%09d", -seconds, -nanoseconds)
  end
  return format("%d.%09d", seconds, nanoseconds)
end

return M
]=])
module("yapp.message.catalogue", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The catalogue compiler: checks the lists of messages once, at load, and prepares decoding.
-- Pure Lua.

local input = require "yapp.base.input"
local decode = require "yapp.message.decode"
local field_kinds = require "yapp.message.field_kinds"
local fields = require "yapp.message.catalogue_fields"
local text_of = require "yapp.message.text"

local demand, shown = input.demand, input.shown

-- Bytes of a message's title: Wireshark aborts at a preference with a longer one.
local MAX_TITLE = 200

local M = {}

local DERIVED_OPTIONS = input.set("unit")
local OPTIONS = input.set("name title section id size min_size info info_rest every answers " ..
  "differences derived")

-- Filters ----------------------------------------------------------------------------------------

-- Return the description of a field, a flag or a generated value.
local function describe(message, one)
  local text = one.title
  if one.unit then text = text .. " in " .. one.unit end
  if one.min then text = ("%s, %.10g to %.10g"):format(text, one.min, one.max) end
  text = text .. ", of " .. message.title
  if one.section then text = ('%s (section "%s")'):format(text, one.section) end
  return text
end

-- Digits behind the point in a column, by unit.
local DIGITS = { RPM = 0, V = 2, A = 2, W = 0, ["°C"] = 0, ["%"] = 0 }

-- Add the filters of a field's flags.
local function add_flags(message, field, add, about)
  local title, group = field.title, field.group
  add(group .. ".undefined", "UINT32", "Undefined bits", "Bits that nothing defines: " .. about,
    "HEX")
  for _, flag in ipairs(field.flags) do
    local one = { title = flag.title .. ", one of " .. title, section = field.section }
    local text = describe(message, one)
    if flag.help then text = text .. ". " .. flag.help end
    add(flag.filter, "BOOLEAN", flag.title, text, field.size * 8, nil, flag.mask)
  end
  if #field.flags == 0 then return end
  add(field.filter .. ".names", "STRING", title, "Names of the bits that are set: " .. about)
  for way, verb in pairs { raised = "rose", cleared = "fell" } do
    add(group .. "." .. way, "UINT" .. 8 * field.size, title .. " " .. way,
      ("Bits that %s since the source's previous good message: %s"):format(verb, about), "HEX")
  end
end

-- Add the filters of a field.
local function add_field(message, field, add)
  local title, about = field.title, describe(message, field)
  local kind, base = field_kinds.BY_NAME[field.kind].filter(field)
  if field.kind == "flags" then
    add_flags(message, field, add, about)
  elseif field.special then
    local why = "Why there is no number, a reserved count, NaN or infinity: " .. about
    add(field.special, "UINT8", title, why, nil, field_kinds.SPECIALS)
  end
  local mask = kind:find("^UINT") and field.mask or nil
  add(field.filter, kind, title, about, base, field.values, mask)
end

-- Add the filters of a message's state, by the names of message.history.
local function add_state(message, add)
  -- Prefer a field of nothing but faults: so filters keep their names if a flag of another field
  -- becomes a fault.
  local fault, states = message.fault_field or message.alarms[1], message.states
  if message.time then
    states.drift = add(message.filter .. ".clock_drift", "RELATIVE_TIME", "Clock drift",
      "Controller's clock less the capture's since the source's first message or reboot")
  end
  if message.answers then
    local command = message.answers:gsub("^%l", string.upper):gsub("_", " ")
    states.command_in = add(("%s.%s_in"):format(message.filter, message.answers), "FRAMENUM",
      ("Latest %s in"):format(command),
      ("The latest %s on this bus before the message"):format(command), nil, "REQUEST")
  end
  if not fault then return end
  message.fault_names = add(fault.group .. ".active_names", "STRING", "Faults",
    "Names of all fault flags that are set in a message")
  states.active_time = add(fault.group .. ".active_time", "RELATIVE_TIME",
    "Time since the oldest fault was raised",
    "Since the oldest fault that is still set was raised")
  for _, way in ipairs { "raised", "cleared" } do
    states[way .. "_in"] = add(("%s.%s_in"):format(fault.group, way), "FRAMENUM",
      ("%s: %s in"):format(fault.title, way),
      ("The message in which %s"):format(way == "raised" and
        "the first of the faults was raised" or "the last of the faults was cleared"))
  end
  for _, way in ipairs { "previous", "next" } do
    states[way .. "_change"] = add(("%s.%s_change"):format(fault.group, way), "FRAMENUM",
      ("%s: %s change in"):format(fault.title, way),
      ("The source's %s message that changes a fault"):format(way))
  end
end

-- Add the filters of values with as many digits as a column needs.
local function add_rounded(message, add)
  for _, list in ipairs { message.fields, message.generated } do
    for _, one in ipairs(list) do
      local digits = DIGITS[one.unit or false]
      if digits and one.shape and not one.array then
        table.insert(message.rounded, {
          filter = add(one.filter .. ".rounded", "DOUBLE", one.title,
            ("%s of %s, rounded for a column: not among a packet's details")
              :format(one.title, message.title)),
          field = one,
          shape = ("%%.%df"):format(digits),
        })
      end
    end
  end
end

-- Add all filters of a message.  Raise that a filter is there twice or is reserved.
local function add_filters(message, reserved, context)
  local taken, filters = {}, {}
  local function add(filter, ...)
    demand(not (taken[filter] or reserved[filter]), "the filter name %s is taken", filter)
    taken[filter] = true
    table.insert(message.filters, { filter, ... })
    filters[#filters + 1] = filter
    return filter
  end
  add(message.filter, "NONE", message.title, "A whole message: " .. message.title)
  add_state(message, add)
  for _, item in ipairs(message.generated) do
    add(item.filter, "DOUBLE", item.title, describe(message, item))
  end
  for _, field in ipairs(message.fields) do
    local array = field.array or field -- its elements share the filters
    context.field, filters = field.name, {}
    if not array.filters then
      add_field(message, array, add)
      array.filters = filters
    end
    field.filters = array.filters
  end
  context.field = nil
  add_rounded(message, add)
end

-- Generated values -------------------------------------------------------------------------------

-- Return a field of numbers of a message.
-- what  the item that needs it: "derived dc_power"
local function number_field(message, what, name)
  local field = message.by_name[name]
  demand(field and field_kinds.is_number(field), "%s: %s is no field of numbers", what, shown(name))
  return field
end

-- Add a value that is worked out from two fields.
-- text     "field * field"
-- returns  the item of message.generated
local function add_generated(message, what, name, text, title, unit)
  local a, operator, b = tostring(text):match("^ *([%w_]+) *([*+-]) *([%w_]+) *$")
  demand(a, '%s: %s is not two fields with *, + or - between them: "voltage * current"', what,
    shown(text))
  local item = {
    name = name,
    title = title,
    unit = unit,
    filter = message.filter .. "." .. name,
    kind = "derived",
    shape = "%.7g",
    operator = operator,
    a = number_field(message, what, a),
    b = number_field(message, what, b),
  }
  table.insert(message.generated, item)
  return item
end

-- differences: { name, field, field, title }; derived: { name, "field * field", title, unit = }
local function add_all_generated(message, entry)
  for i, row in ipairs(entry.differences or {}) do
    local what, first = input.row(row, "difference", i, 4, {}), message.by_name[row[2] or false]
    local text = ("%s - %s"):format(row[2], row[3])
    add_generated(message, what, row[1], text, row[4], first and first.unit)
  end
  for i, row in ipairs(entry.derived or {}) do
    local what = input.row(row, "derived", i, 3, DERIVED_OPTIONS)
    message.derived[i] = add_generated(message, what, row[1], row[2], row[3], row.unit)
  end
end

-- A message --------------------------------------------------------------------------------------

local function check_head(entry)
  local every, answers = entry.every, entry.answers
  demand(input.is_text(entry.title), "the title is missing")
  input.options(entry, "a message", OPTIONS, math.huge)
  demand(#entry.title <= MAX_TITLE, "the title has more than %d bytes", MAX_TITLE)
  input.within("id", entry.id, 0, input.MAX_ID)
  input.within("size", entry.size, 1, fields.MAX_SIZE)
  input.within("min_size", entry.min_size or entry.size, 1, entry.size)
  demand(not every or input.is_finite(every) and every > 0,
    "every %s is not a period in seconds", shown(every))
  demand(not answers or input.is_name(answers), "answers %s is not the name of a message",
    shown(answers))
  demand(#entry > 0, "it has no fields")
end

-- context  the subject of errors: context.field is set to the name of the current field, or nil
local function compile_message(entry, reserved, context)
  check_head(entry)
  local message = {
    name = entry.name,
    title = entry.title,
    section = entry.section,
    id = entry.id,
    size = entry.size,
    min_size = entry.min_size or entry.size,
    every = entry.every,
    answers = entry.answers,
    filter = "taurus." .. entry.name,
    fields = {},
    by_name = {},
    flag_fields = {},
    alarms = {},
    generated = {},
    derived = {},
    rounded = {},
    states = {},
    filters = {},
  }
  local size = fields.compile(message, entry, context)
  demand(size == entry.size, "size is %d, but the fields add up to %d bytes", entry.size, size)
  message.read = decode.new_reader(message)
  message.info = text_of.compile_info(message, entry.info or "")
  message.info_rest = text_of.compile_info(message, entry.info_rest or entry.info or "")
  add_all_generated(message, entry)
  add_filters(message, reserved, context)
  return message
end

-- All messages -----------------------------------------------------------------------------------

local function add_message(catalogue, entry, reserved, context)
  demand(type(entry) == "table", "a message is a table, not %s", shown(entry))
  local name = entry.name
  demand(input.is_name(name), "name %s is not a filter name (a-z, 0-9, _)", shown(name))
  context.message = name
  demand(not catalogue.names[name], "the name is there twice")
  catalogue.names[name] = true
  local message = compile_message(entry, reserved, context)
  local other = catalogue.by_id[message.id]
  demand(not other, "id 0x%X is that of message %s", message.id, other and other.name)
  catalogue.messages[#catalogue.messages + 1] = message
  catalogue.by_id[message.id] = message
end

--- Check a catalogue and compile it.
-- entries   the list of messages in taurus_fields.lua, described there
-- origins   optional list: { file, number in it } of each entry; a text about it begins with that
-- reserved  optional { [filter name] = true } that no message may use
-- returns   { messages = list, by_id = { [id] = message } } of the messages without a mistake, and
--           a list of texts, one for each other message: which field is wrong and why
-- A compiled message has
--   name, title, id, filter ("taurus.motor"); section of a document, every (period in seconds) and
--   answers (a message's name), or nil
--   size, min_size (bytes: a shorter payload is not this message)
--   fields, by_name, time (its first field of kind time)
--   flag_fields (its fields of flags), alarms (those with a fault flag), fault_field (the first one
--   whose flags are all faults)
--   generated: a list of the values that are worked out from two fields: { name, title, filter,
--   unit, kind = "derived", shape, operator ("*", "-", "+"), a and b (the fields) }
--   derived: those of them that are columns of CSV, too
--   rounded: a list of the values for columns, { filter, field (or one of generated), shape }
--   filters: a list of { filter, type, title, description, base, values, mask }, see show.fields
--   states: the filters of its state, { [its name in message.history] = filter }
--   fault_names: the filter of the names of all faults that are set, nil without fault flags
--   read (see decode.new_reader), info and, beside columns, info_rest (see text.compile_info)
-- A field has name, title, filter, filters (a list of it and those below it), index (in fields),
-- offset, size in bytes, type, unit and section or nil, shape (a format with as many digits as its
-- count can carry; nil for ieee and integers), and kind, with the values that its kind needs:
--   uint, int  bottom, top; values, invalid, cases (a set); mask, low, inside: a part of the bits
--              of another field
--   scaled     the same, and scale, zero: value = count * scale + zero
--   flags      flags { name, mask, title, filter, help or nil }, group, undefined and watched
--              (masks: bits that nothing defines; bits outside of parts, whose changes are
--              reported), alarm_bits (mask: bits that are faults), fault_word (in Info, before
--              their names)
--   float      compressed: min, max, top, ordinary (the highest count that is not reserved)
--   ieee, bool, string, bytes, time
-- An element of an array has array, the common part of the elements; a field in a case of
-- variants has when = { index, value }.
function M.compile(entries, origins, reserved)
  local catalogue, problems = { messages = {}, by_id = {}, names = {} }, {}
  for i = 1, #entries do
    local origin = origins and origins[i] or {}
    local context = { message = origin.number or i }
    local ok, problem = pcall(add_message, catalogue, entries[i], reserved or {}, context)
    if not ok then
      local file = origin.file and origin.file .. ": " or ""
      local field = context.field and ", field " .. context.field or ""
      problems[#problems + 1] =
        ("%smessage %s%s: %s"):format(file, context.message, field, tostring(problem))
    end
  end
  return catalogue, problems
end

--- Return those of a list of messages that may have a payload of this size, in bytes.
function M.of_size(messages, size)
  local list = {}
  for _, message in ipairs(messages) do
    if size >= message.min_size and size <= message.size then list[#list + 1] = message end
  end
  return list
end

--- Say which message each ID carries.
-- catalogue  compiled
-- ids        { [message name] = list of IDs }, the user's choice
-- returns    { [id] = message }, and a list of texts for IDs that two messages claim: the first
--            keeps it
function M.assign(catalogue, ids)
  local by_id, problems = {}, {}
  for _, message in ipairs(catalogue.messages) do
    for _, id in ipairs(ids[message.name] or { message.id }) do
      local other = by_id[id] or message
      by_id[id] = other
      if other ~= message then
        problems[#problems + 1] = ("ID 0x%X is given to %s and to %s: it stays with %s")
          :format(id, other.title, message.title, other.title)
      end
    end
  end
  return by_id, input.few(problems)
end

return M
]=])
module("yapp.message.catalogue_fields", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- From the rows of a message to its fields: types and options checked, offsets worked out.
-- Pure Lua.  A mistake in a row is raised as a text; message.catalogue adds the message and the
-- field.

local band = require "yapp.base.bits".band
local field_kinds = require "yapp.message.field_kinds"
local input = require "yapp.base.input"

local demand, shown, set = input.demand, input.shown, input.set
local is_name, is_text = input.is_name, input.is_text
local is_finite = input.is_finite

local M = {}

--- The largest payload, in bytes.
M.MAX_SIZE = 65535
-- The expert items for values.
local INVALID = set("value.invalid command.key.invalid")

-- Types ------------------------------------------------------------------------------------------

local SCALED = "section unit scale offset count"
local SIGNED = SCALED .. " values invalid"
local UNSIGNED = SIGNED .. " flags group alarm bits"
local FLOAT = "section min max unit count"
local PART_OPTIONS = set("section values invalid unit scale offset")
local FLAG_OPTIONS = set("alarm help")

-- [name] = { size in bytes (nil: from the row), kind, options, top and bottom (highest and lowest
-- count) }
local TYPES = {
  int64_ns = { kind = "time", size = 8, options = set("section") },
  bool = { kind = "bool", size = 1, bottom = 0, top = 1, options = set("section count") },
  string = { kind = "string", options = set("section length count") },
  bytes = { kind = "bytes", options = set("section length count") },
  padding = { kind = "padding", options = set("length") },
  variants = { kind = "variants", options = set("by cases") },
}

local function add_numbers(kind, size, bottom, top, options)
  TYPES[kind .. 8 * size] = {
    kind = kind,
    size = size,
    -- COMPAT 5.4: powers are floats there, which are printed with a ".0".
    bottom = math.floor(bottom),
    top = math.floor(top),
    options = set(options),
  }
end

for size = 1, 8 do
  local span = 2 ^ (8 * size)
  add_numbers("float", size, 0, span - 1, FLOAT)
  if size <= 4 then
    add_numbers("uint", size, 0, span - 1, UNSIGNED)
    add_numbers("int", size, -span / 2, span / 2 - 1, SIGNED)
  end
end
add_numbers("uint", 8, 0, 2 ^ 64 - 1, SCALED)
add_numbers("int", 8, -2 ^ 63, 2 ^ 63 - 1, SCALED)

--- The names of all types, for a message.
M.TYPE_NAMES = input.names(TYPES)

-- Options ----------------------------------------------------------------------------------------

-- Raise that a number has no room in a field.
local function check_fits(field, what, number, lowest)
  local fits = input.is_integer(number) and number >= lowest and number <= field.top
  demand(fits, "%s %s does not fit the type %s", what, shown(number), field.type)
end

-- A linear scale: value = count * scale + offset.
local function add_scale(field, row)
  local scale, zero = row.scale or 1, row.offset or 0
  demand(is_finite(scale) and scale ~= 0, "scale %s is not a number but 0", shown(scale))
  demand(is_finite(zero), "offset %s is not a number", shown(zero))
  demand(not (row.values or row.flags or row.bits),
    "a field has a scale, or values, flags and bits, not both")
  demand(is_finite(field.top * scale + zero), "scale %s is too large", shown(scale))
  field.kind, field.shape = "scaled", "%.15g"
  field.scale, field.zero = scale + 0.0, zero + 0.0 -- COMPAT 5.4: products of integers wrap around
end

-- The digits that a compressed float of so many bytes can carry.
local DIGITS = { 7, 7, 10, 10, 15, 15, 15, 15 }

-- min and max make a compressed float of the bytes; without them float32 and float64 are IEEE
-- 754's.
local function add_range(field, row)
  local min, max, size = row.min, row.max, field.size
  field.special = field.filter .. ".special"
  if min == nil and max == nil and (size == 4 or size == 8) then
    field.kind = "ieee"
    return
  end
  local is_range = is_finite(min) and is_finite(max) and min < max
  demand(is_range, "%s needs min and max, min below max", field.type)
  local largest = math.max(math.abs(min), math.abs(max)) * field.top
  demand(is_finite(2 * largest), "the range from %s to %s is too large", min, max)
  field.min, field.max = min + 0.0, max + 0.0 -- COMPAT 5.4: products of integers wrap around
  field.shape = "%." .. DIGITS[size] .. "g"
  -- A double holds counts of six bytes.  Of longer ones, reserved values are read as negative
  -- numbers.
  field.ordinary = size > 6 and field.top or field.top - 5
end

-- Fields -----------------------------------------------------------------------------------------

local function length_of(row)
  input.within(row[2] .. " needs a length, and", row.length, 1, M.MAX_SIZE)
  return row.length
end

-- Make the field of a row, or of a part of bits, without its offset.
-- def  of TYPES; for a part of bits also `type`: the name of the field's type
local function new_field(message, row, def)
  local field = {
    name = row[1],
    title = row[3],
    type = def.type or row[2],
    kind = def.kind,
    filter = message.filter .. "." .. row[1],
    size = def.size or length_of(row),
    top = def.top,
    bottom = def.bottom,
    unit = row.unit,
    section = row.section or message.section,
    values = row.values,
  }
  local invalid = row.invalid or "value.invalid"
  demand(INVALID[invalid], "invalid is value.invalid or command.key.invalid")
  if row.values or field.kind == "bool" then field.invalid = invalid end
  if field.kind == "float" then add_range(field, row) end
  if row.scale or row.offset then add_scale(field, row) end
  for value, meaning in pairs(row.values or {}) do
    check_fits(field, "value", value, field.bottom)
    demand(is_text(meaning), "value %s has no meaning in words", shown(value))
  end
  return field
end

-- Put a field at its offset in the message.
local function add_field(build, field)
  local message, offset = build.message, build.offset
  local min_size, name = message.min_size, field.name
  demand(not message.by_name[name], "the name is there twice")
  demand(min_size <= offset or min_size >= offset + field.size, "min_size %d ends inside it",
    min_size)
  field.offset, field.when = offset, build.when
  table.insert(message.fields, field)
  field.index = #message.fields
  message.by_name[name] = field
  if field.kind == "time" and not build.when then message.time = message.time or field end
end

-- Flags and parts of bits ------------------------------------------------------------------------

-- Check the i-th flag, or part, { name, mask, title }, and mark its bits as defined.
-- returns  its name in errors: "flag stopped"
local function define_bits(field, row, what, i, options)
  what = input.row(row, what, i, 3, options)
  local mask = row[2]
  check_fits(field, what .. ": mask", mask, 1)
  local taken = mask - band(mask, field.undefined)
  demand(taken == 0, "%s: bit 0x%X is already another's", what, taken)
  field.undefined = field.undefined - mask
  return what
end

local function add_flag(field, row, i)
  local what = define_bits(field, row, "flag", i, FLAG_OPTIONS)
  local name, mask = row[1], row[2]
  demand(row.alarm == nil or row.alarm == true, "%s: alarm is true, or is not there", what)
  if row.alarm then field.alarm_bits = field.alarm_bits + mask end
  field.flags[i] = {
    name = name,
    mask = mask,
    title = row[3],
    help = row.help,
    filter = field.group .. "." .. name,
  }
end

-- Make a part of a field: a field with a mask, whose counts begin at the mask's lowest bit.
local function new_part(message, field, row, i)
  local what = define_bits(field, row, "bits", i, PART_OPTIONS)
  local mask, low = row[2], 1
  while mask % (2 * low) == 0 do low = low * 2 end
  local top = mask / low
  demand(band(top, top + 1) == 0, "%s: the bits of mask 0x%X are not side by side", what, mask)
  field.watched = field.watched - mask
  local part = new_field(message, row,
    { kind = "uint", type = field.type, size = field.size, bottom = 0, top = top })
  part.inside, part.mask, part.low = field, mask, low
  return part
end

-- Turn a field that is at its offset already into one of flags, of parts, or of both.
local function add_bits(build, field, row)
  local message, word = build.message, row.alarm
  local group = row.group or not row.flags and field.name
  demand(is_name(group), "flags need a group, a name for their filters")
  demand(word == nil or is_text(word), "alarm is a word, for a field with flags")
  demand(not row.values, "a field has values or flags, not both")
  field.kind = "flags"
  field.group = message.filter .. "." .. group
  field.flags = {}
  field.alarm_bits = 0
  field.undefined = field.top
  field.watched = field.top
  for i, flag in ipairs(row.flags or {}) do add_flag(field, flag, i) end
  for i, part in ipairs(row.bits or {}) do
    add_field(build, new_part(message, field, part, i))
  end
  table.insert(message.flag_fields, field)
  if word then
    field.alarm_bits = field.watched
    message.fault_field = message.fault_field or field
  end
  if field.alarm_bits == 0 then return end
  field.fault_word = word or "FAULT"
  table.insert(message.alarms, field)
end

-- Rows -------------------------------------------------------------------------------------------

-- An array is its elements: fields of their own with one filter name.
local function add_elements(build, field, count)
  input.within("count", count, 1, M.MAX_SIZE)
  for i = 1, count do
    local element = {}
    for name, value in pairs(field) do element[name] = value end
    element.name = field.name .. "_" .. i
    element.title = field.title .. " " .. i
    element.array = field
    add_field(build, element)
    build.offset = build.offset + element.size
  end
end

local add_rows

-- The cases lie over one another, as in a union of C: the longest says where the message goes on.
local function add_variants(build, row)
  local by = build.message.by_name[row.by or false]
  demand(by and field_kinds.BY_NAME[by.kind].is_integer and by.size <= 4 and not by.cases,
    "by %s is not an earlier integer of the message, one for each row of variants", shown(row.by))
  demand(not build.when, "variants are not for a case of others")
  demand(row.cases, "cases is missing")
  local values = {}
  for value in pairs(row.cases) do
    check_fits(by, "value", value, by.bottom)
    values[#values + 1] = value
  end
  table.sort(values)
  by.cases, by.invalid = {}, by.invalid or "value.invalid"
  local start, longest = build.offset, build.offset
  for _, value in ipairs(values) do
    by.cases[value] = true
    build.offset = start
    build.when = { index = by.index, value = value }
    add_rows(build, row.cases[value])
    longest = math.max(longest, build.offset)
  end
  build.offset, build.when = longest, nil
end

local function add_row(build, row)
  local name, kind = row[1], row[2]
  demand(is_name(name), "%s is not a filter name (a-z, 0-9, _)", shown(name))
  local def = TYPES[kind or false]
  demand(def, "unknown type %s; the types are %s", shown(kind), M.TYPE_NAMES)
  input.options(row, "type " .. kind, def.options, 3)
  if def.kind == "variants" then return add_variants(build, row) end
  if def.kind == "padding" then
    build.offset = build.offset + length_of(row)
    return
  end
  demand(is_text(row[3]), "the title is missing")
  local field = new_field(build.message, row, def)
  local has_bits = row.flags or row.bits
  demand(has_bits or not (row.group or row.alarm),
    "group and alarm are for a field with flags")
  demand(not (has_bits and row.count), "flags and bits are not for an array")
  if row.count then return add_elements(build, field, row.count) end
  add_field(build, field)
  if has_bits then add_bits(build, field, row) end
  build.offset = build.offset + field.size
end

-- Fields in the order of the rows; build.offset is then behind the last.
function add_rows(build, rows)
  for i, row in ipairs(rows) do
    build.context.field = i
    demand(type(row) == "table", "a field is a row { name, type, title }, not %s", shown(row))
    if is_name(row[1]) then build.context.field = row[1] end
    add_row(build, row)
  end
end

--- Compile the rows of a message into its fields, by_name, time, flag_fields and alarms.
-- message  its compiled head, with these tables, empty
-- context  the subject of errors: context.field is set to the name or number of the current row
-- returns  the sum of the sizes in bytes.  It raises what is wrong.
function M.compile(message, rows, context)
  local build = { message = message, context = context, offset = 0, when = nil }
  add_rows(build, rows)
  context.field = nil
  return build.offset
end

return M
]=])
module("yapp.message.catalogue_files", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The files of the catalogue: the plugin's own messages, and those of the user, which come after
-- and may replace them.  Pure Lua.

local compiler = require "yapp.message.catalogue"
local input = require "yapp.base.input"

local M = {}

local DENIED = 13 -- EACCES
local MAX_ERROR = 500 -- of an error of the file's own
local KEYED = "%s: the entry %s is not read: a message has its name inside, " ..
  "{ { name = ... }, { name = ... } }, and no key in front"
local GAP = "%s: message %d of the list is nil: a variable that is not defined, or misspelt?"

local function run(path)
  return assert(loadfile(path))()
end

-- Return the value of a file, or nil and an error.
local function read(path)
  local file, problem, code = io.open(path)
  if not file then
    -- The system's message begins with the path and is in the user's language, so "not found" is
    -- ours.
    return nil, code == DENIED and "cannot be read: " .. problem or "not found"
  end
  file:close()
  local ok, entries = pcall(run, path)
  if not ok then
    return nil, "the catalogue cannot be read: " .. tostring(entries):sub(1, MAX_ERROR)
  end
  if type(entries) ~= "table" then
    return nil, "the file must return a list of messages, not " .. input.shown(entries)
  end
  if type(entries.name) == "string" then
    return nil, "the file must return a list of messages, { { name = ... } }, not one"
  end
  return entries
end

local function name_of(entry)
  return type(entry) == "table" and entry.name or nil
end

-- Add the messages of a file in their order; one with the name of a message of an earlier file
-- takes its index.
-- all       { entries = list, origins = list of { file, number } }
-- problems  gets a text for each entry that has a name instead of a number, and for the first gap
local function add_entries(all, entries, path, problems)
  local numbers, index_of = {}, {}
  for i, entry in ipairs(all.entries) do
    local name = name_of(entry)
    if name then index_of[name] = i end
  end
  for key in next, entries do
    if input.is_integer(key) and key >= 1 then
      numbers[#numbers + 1] = key
    else
      problems[#problems + 1] = KEYED:format(path, input.shown(key))
    end
  end
  table.sort(numbers)
  for i, number in ipairs(numbers) do
    if number ~= i and (numbers[i - 1] or 0) == i - 1 then
      problems[#problems + 1] = GAP:format(path, i)
    end
    local entry = entries[number]
    local index = index_of[name_of(entry)] or #all.entries + 1
    all.entries[index], all.origins[index] = entry, { file = path, number = number }
  end
end

--- Read the files of the catalogue and compile them as one.
-- files    list of { path =, optional = whether the file may be missing }, in order: a message of a
--          later file replaces one of the same name
-- reserved  optional { [filter name] = true } that no message may use
-- returns  the compiled catalogue and a list of texts, each with the file, the message and the
--          field that is wrong, see message.catalogue.compile
function M.load(files, reserved)
  local all, problems = { entries = {}, origins = {} }, {}
  for _, file in ipairs(files) do
    local entries, problem = read(file.path)
    if entries then
      add_entries(all, entries, file.path, problems)
    elseif not (file.optional and problem == "not found") then
      problem = problem .. "; its messages are not decoded"
      problems[#problems + 1] = file.path .. ": " .. problem
    end
  end
  local compiled, found = compiler.compile(all.entries, all.origins, reserved)
  for _, text in ipairs(found) do
    problems[#problems + 1] = text .. "; this message is not decoded"
  end
  return compiled, input.few(problems)
end

--- The value of a preference in a file of Wireshark's preferences, nil where it has none.
-- While a plugin loads, the API tells no preference; but only then can fields be registered.
function M.preference(path, name)
  local file = io.open(path)
  if not file then return nil end
  local text = "\n" .. (file:read("*a") or "") .. "\n"
  file:close()
  local _, colon = text:find(("\n%s:"):format(name), 1, true)
  local value = colon and text:match("^[ \t]*([^\r\n]-)[ \t\r]*\n", colon + 1)
  return value ~= "" and value or nil
end

return M
]=])
module("yapp.message.decode", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- From the payload of a message to its values, by the compiled catalogue: raw values, little endian
-- ("YAPP Data Types", "YAPP Float Compression", "Time"), their meaning, and which of them are
-- remarkable.  Pure Lua.

local field_kinds = require "yapp.message.field_kinds"

local M = {}

local concat = table.concat
local byte, find, format = string.byte, string.find, string.format
local KINDS = field_kinds.BY_NAME

local MAX_KEPT = 100 -- bytes of a payload in local variables: a function has up to 200

-- Reading ----------------------------------------------------------------------------------------

-- The reader of a message is made from Lua source: a loop over the fields takes 5 % more of a
-- packet list.  The first bytes of a payload are in b1, b2, ...; a missing one is nil.
local READER = [[
local FIELDS, byte, kinds = ...
local band, value_of, is_undefined = kinds.band, kinds.value_of, kinds.is_undefined
return function(payload)
local raws, remarks, a = { %s }, false
local %s = byte(payload, 1, %d)
%s
return raws, remarks
end]]
local REMARK = "if %s then remarks = remarks or {} FIELDS[%d]:remark(a, remarks) end"


-- Return the lines that read the i-th field of a message.
local function field_source(field, i)
  local last, when, value = field.offset + field.size, field.when, {}
  local is_there = last <= MAX_KEPT and "b" .. last or "#payload >= " .. last
  if when then is_there = format("%s and raws[%d] == %d", is_there, when.index, when.value) end
  for j = 1, field.size do
    value[j] = format("b%d * %.0f", field.offset + j, 0x100 ^ (j - 1))
  end
  value = concat(value, " + ")
  if field.read ~= field_kinds.read_count or last > MAX_KEPT then
    value = format("FIELDS[%d]:read(payload)", i)
  end
  local source = KINDS[field.kind].source
  local condition = source and source(field, i)
  local remark = condition and format(REMARK, condition, i) or ""
  return format("if %s then a = %s raws[%d] = a %s end", is_there, value, i, remark)
end

--- Make the reader of a message.
-- message  compiled, but for this
-- returns  function(payload).  Of a payload that is shorter than the message, it reads the fields
--          that are whole.  It does not read the bytes behind the message.  It returns
--            { [index of field] = raw }, see message.field_kinds, without missing fields and cases
--            that are not chosen
--            the remarkable values, false for none: a list of { index of field, expert, whether the
--            catalogue does not define the value }, with has_fault = true if a fault flag is set
function M.new_reader(message)
  local nils, names, lines = {}, {}, {}
  for i, field in ipairs(message.fields) do
    field.read, field.remark = KINDS[field.kind].choose(field), KINDS[field.kind].remark
    nils[i], lines[i] = "nil", field_source(field, i) -- a table that grows by itself takes longer
  end
  for i = 1, math.min(message.size, MAX_KEPT) do names[i] = "b" .. i end
  local source =
    format(READER, concat(nils, ", "), concat(names, ", "), #names, concat(lines, "\n"))
  local read = load(source, "=reader of " .. message.name)
  return read(message.fields, byte, field_kinds.ENVIRONMENT)
end

--- Return whether bytes look like a message: all its values are defined, and at least two of its
-- fields have values that are not.  Random bytes of Command's size do in one of two million cases.
-- Zeros look like anything, so they do not count.
function M.is_plausible(message, payload)
  if not find(payload, "[^%z]") then return false end
  local _, remarks = message.read(payload)
  for _, remark in ipairs(remarks or {}) do
    if remark[3] then return false end
  end
  local checked = 0
  for _, field in ipairs(message.fields) do
    if field.invalid or field.undefined and field.undefined ~= 0 then checked = checked + 1 end
  end
  return checked >= 2
end

return M
]=])
module("yapp.message.faults", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The faults of a source: each from the message that raises it to the message that clears it.
-- Pure Lua.

local band = require "yapp.base.bits".band
local memo = require "yapp.base.memo"

local M = {}

local NONE = {} -- to be read only

local Faults = {}
Faults.__index = Faults

--- Make the faults of a source: none is set.
function M.new()
  return setmetatable({
    set = NONE, -- list of the faults that are set, as they rose; a new one for each change
    incident = nil, -- see Faults:update
  }, Faults)
end

-- By field: the flags that are faults, with the bits that no table defines.
local faults_of = memo(function(field)
  local list = {}
  for _, flag in ipairs(field.flags) do
    if band(flag.mask, field.alarm_bits) ~= 0 then list[#list + 1] = flag end
  end
  local undefined = band(field.undefined, field.alarm_bits)
  for bit = 0, 31 do
    local mask = 2 ^ bit
    if band(undefined, mask) ~= 0 then
      list[#list + 1] = { name = ("undefined_0x%x"):format(mask), mask = mask }
    end
  end
  return list
end)

-- Return the fault of a flag that is set, and the list without it; nil and a copy for none.
local function take_out(set, flag)
  local others, found = {}, nil
  for _, fault in ipairs(set) do
    if fault.flag == flag then found = fault else others[#others + 1] = fault end
  end
  return found, others
end

-- Add the steps of one field.
local function update_field(self, change, time, steps)
  local field, now = change.field, change.value
  local before = now - change.raised + change.cleared
  for _, flag in ipairs(faults_of[field]) do
    local is_set = band(now, flag.mask) ~= 0
    if is_set ~= (band(before, flag.mask) ~= 0) then
      local fault, set = take_out(self.set, flag)
      fault = fault or { field = field.name, flag = flag, time = time, incident = self.incident }
      if is_set then set[#set + 1] = fault end
      self.set = set
      steps[#steps + 1] = { fault = fault, is_raised = is_set }
    end
  end
end

--- Update the faults with a message.
-- changes  list of { field, value, raised = mask, cleared = mask }, see message.history
-- time     seconds of the capture
-- returns  the steps, a list of { fault, is_raised = whether it rises or falls }, with set = list
--          of the faults that are set behind the message; nil if no bit of a fault changes.
--          A fault is one table from its rise to its fall: { field = name, flag,
--            time      when it rose
--            incident  a table for the time in which a fault is set without a break }
function Faults:update(changes, time)
  local steps = nil
  -- An incident goes on if one field falls and another rises in the same message.
  if not self.set[1] then self.incident = {} end
  for _, change in ipairs(changes) do
    if band(change.raised + change.cleared, change.field.alarm_bits) ~= 0 then
      steps = steps or {}
      update_field(self, change, time, steps)
    end
  end
  if steps then steps.set = self.set end
  return steps
end

--- Return when the oldest fault that is set rose; false for none.
function Faults:oldest_time()
  local oldest = false
  for _, fault in ipairs(self.set) do
    if not oldest or fault.time < oldest then oldest = fault.time end
  end
  return oldest
end

return M
]=])
module("yapp.message.field_kinds", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The kinds of field, a record each: the reading of its bytes, its values, its remarkable values,
-- and its forms in filters, Info and CSV.  Pure Lua.
--
-- A new kind is a record here, and the types that have it in message.catalogue_fields.
--
-- A raw value is the integer or the count as sent.  Exceptions: the number of ieee; the decimal
-- digits of a 64 bit integer beyond 2^53; the bytes of times, strings and bytes; -1 - n for special
-- n of a compressed float of seven or eight bytes.

local binary = require "yapp.message.binary"
local bits = require "yapp.base.bits"
local utf8 = require "yapp.base.utf8"

local M = {}

local floor = math.floor
local byte, find, format, sub = string.byte, string.find, string.format, string.sub

--- The reserved values of compressed floats, from the highest count down ("YAPP Float
-- Compression").  The index is the value of <field>.special.
M.SPECIALS = {
  [0] = "Not a Number",
  "Positive Infinity",
  "Negative Infinity",
  "Out of Range High",
  "Out of Range Low",
}

-- Compressed floats: floatN <min; max> has counts 0 .. top, top = 2^N - 1.  The five highest counts
-- are reserved values; the others map linearly:  value = min + count * (max - min) / (top - 5).
-- The document's worked examples divide by top - 4; its mapping table and the 0 A of the captured
-- example prove top - 5.
M.MAPPING = 5
M.WORKED_EXAMPLES = 4

--- Compressed floats divide by top - below_top.
M.below_top = M.MAPPING

--- Choose the divisor of all compressed floats.
-- below_top  M.MAPPING, or M.WORKED_EXAMPLES to reproduce the printed figures
function M.use_below_top(below_top)
  M.below_top = below_top
end

-- Reading ----------------------------------------------------------------------------------------
--
-- function(field, payload) -> raw

--- Read a count of fewer than seven bytes and without a sign.
function M.read_count(field, payload)
  return binary.count(payload, field.offset + 1, field.size)
end

local function read_signed(field, payload)
  local count = M.read_count(field, payload)
  return count > field.top and count - 2 * (field.top + 1) or count
end

local function read_part(field, payload)
  return floor(M.read_count(field, payload) / field.low) % (field.top + 1)
end

local function read_integer64(field, payload)
  return binary.integer64(payload, field.offset + 1, field.bottom < 0)
end

local function read_bytes(field, payload)
  return sub(payload, field.offset + 1, field.offset + field.size)
end

local function read_long_float(field, payload)
  local lowest, others = byte(payload, field.offset + 1), sub(read_bytes(field, payload), 2)
  if lowest >= 0xFB and not find(others, "[^\255]") then return lowest - 0x100 end
  return M.read_count(field, payload)
end

local function read_ieee(field, payload)
  return binary.ieee(payload, field.offset + 1, field.size, field.size == 4 and 23 or 52)
end

local function choose_integer(field)
  if field.size > 6 then return read_integer64 end
  if field.mask then return read_part end
  return field.bottom < 0 and read_signed or M.read_count
end

local function choose_float(field)
  return field.size > 6 and read_long_float or M.read_count
end

-- Texts ------------------------------------------------------------------------------------------

--- Return the value of a field in its unit, unrounded.
-- raw      see above
-- returns  a number; a string for strings, bytes (hexadecimal) and integers beyond 2^53; nil where
--          there is none, and then which special (0 .. 4, as <field>.special has it) for a float
--          that is no number
function M.value(field, raw)
  if not raw then return nil end
  local value_of = M.BY_NAME[field.kind].value
  if value_of then return value_of(field, raw) end
  return raw
end

--- Return a number as a text with as many digits as its count can carry: "1.1" for
-- 11 * 0.1 = 1.1000000000000001, so that a filter `== 1.1` matches it.
-- field  or an item of message.generated
-- value  of M.value
function M.number_text(field, value)
  if field.shape then return format(field.shape, value) end
  if type(value) == "string" then return value end -- an integer beyond 2^53
  -- COMPAT 5.2: tostring has 14 digits
  if field.kind ~= "ieee" then return format("%.0f", value) end
  if field.size == 4 then value = binary.shortest(value) end
  local text = format("%.15g", value)
  return tonumber(text) == value and text or format("%.17g", value)
end

--- Return a function(raw) -> the text of a number, nil where there is none, and then which special.
function M.new_number_text(field)
  return function(raw)
    local value, special = M.value(field, raw)
    if not value then return nil, special end
    return M.number_text(field, value)
  end
end

--- Return a text as a cell of CSV: in quotes where it must be.
function M.quoted(text)
  if text:find('[,"\r\n]') then return '"' .. text:gsub('"', '""') .. '"' end
  return text
end

local SPECIAL_WORDS = { [0] = "NaN", "+inf", "-inf", "above range", "below range" }
-- The cells of a reserved value: no number, and its name.
local SPECIAL_CELLS = { [0] = ",nan", ",inf", ",-inf", ",above", ",below" }
local BOOLS = { [0] = "false", "true" }

-- Functions that make a function(raw) -> the text of a field in Info, or its cells in CSV:

local function number_info(field, shape)
  return function(raw)
    local value, special = M.value(field, raw)
    return special and SPECIAL_WORDS[special] or format(shape, value)
  end
end

local function number_cells(field)
  local write = M.new_number_text(field)
  return function(raw)
    local text, special = write(raw)
    return text and text .. "," or SPECIAL_CELLS[special]
  end
end

local function code_info(field)
  local values, invalid = field.values, "invalid " .. (M.BY_NAME[field.kind].code or "0x%x")
  return function(raw)
    if not values then return M.number_text(field, raw) end
    return values[raw] or format(invalid, raw)
  end
end

local function code_cells(field)
  local values = field.values
  return function(raw)
    local text = M.number_text(field, M.value(field, raw))
    if not values then return text end
    return text .. "," .. M.quoted(values[raw] or "")
  end
end

local function text_info(field)
  return function(raw) return M.value(field, raw) end
end

local function text_cells(field)
  return function(raw) return M.quoted(M.value(field, raw)) end
end

local function time_text(raw)
  return binary.seconds(binary.time(raw, 0))
end

local function flags_cells(field)
  return function(raw)
    local texts = { M.number_text(field, raw) }
    for i, flag in ipairs(field.flags) do
      texts[i + 1] = bits.band(raw, flag.mask) ~= 0 and "1" or "0"
    end
    return table.concat(texts, ",")
  end
end

-- The cell of a generated value.
local function derived_cells(item)
  local write = M.new_number_text(item)
  return function(raws) return write(raws) or "" end
end

-- Remarkable values ------------------------------------------------------------------------------

-- Return whether nothing defines a code.
local function is_undefined(field, raw)
  local values, cases = field.values, field.cases
  return values and not values[raw] or cases and not cases[raw] or field.kind == "bool" and raw > 1
end

-- Append a remark.
-- lacks_meaning  whether the catalogue does not define the value
local function note(remarks, field, expert, lacks_meaning)
  remarks[#remarks + 1] = { field.index, expert, lacks_meaning }
end

local function remark_code(field, _, remarks)
  note(remarks, field, field.invalid, true)
end

local function remark_special(field, _, remarks)
  note(remarks, field, "value.special", false)
end

local function remark_flags(field, raw, remarks)
  if bits.band(raw, field.alarm_bits) ~= 0 then
    note(remarks, field, "fault.active", false)
    remarks.has_fault = true
  end
  if bits.band(raw, field.undefined) ~= 0 then note(remarks, field, "flags.undefined", true) end
end

-- The condition of each as source, in which a is the raw value and FIELDS[i] the field:

local function code_source(field, i)
  return field.invalid and format("is_undefined(FIELDS[%d], a)", i)
end

local function special_source(_, i)
  return format("not value_of(FIELDS[%d], a)", i)
end

local function float_source(field, i)
  if field.size > 6 then return special_source(field, i) end
  return format("a > %.0f", field.ordinary)
end

local function flags_source(field)
  return format("a ~= 0 and band(a, %d) ~= 0", bits.bor(field.alarm_bits, field.undefined))
end

--- The functions that the conditions call, by name.
M.ENVIRONMENT = { band = bits.band, value_of = M.value, is_undefined = is_undefined }

-- The kinds ---------------------------------------------------------------------------------------

-- Return the kind of a filter of a field's width.
local function sized(prefix, base_of)
  return function(field) return prefix .. field.size * 8, base_of(field) end
end

local function decimal()
  return nil
end

local function hexadecimal()
  return "HEX"
end

local function hexadecimal_if_enum(field)
  return field.values and "HEX"
end

-- Return a function that always returns this.
local function always(result)
  return function() return result end
end

local function hex_digits(char)
  return format("%02x", byte(char))
end

local function float_value(field, raw)
  if raw > field.ordinary then return nil, field.top - raw end
  if raw < 0 then return nil, -1 - raw end -- of seven or eight bytes
  -- One division at the end, so that the middle of a symmetric range is 0 and not nearly 0.
  local steps = field.top - M.below_top
  return (field.min * steps + raw * (field.max - field.min)) / steps
end

local function ieee_value(_, raw)
  if raw ~= raw then return nil, 0 end
  if raw - raw ~= 0 then return nil, raw > 0 and 1 or 2 end
  return raw
end

local function time_number(_, raw)
  local seconds, nanoseconds = binary.time(raw, 0)
  return seconds + nanoseconds / 1e9
end

local OPERATORS = {
  ["*"] = function(a, b) return a * b end,
  ["-"] = function(a, b) return a - b end,
  ["+"] = function(a, b) return a + b end,
}

-- Work out a generated value from its two fields; nil where one of them has no value.
local function derived_value(item, raws)
  local a, b = M.value(item.a, raws[item.a.index]), M.value(item.b, raws[item.b.index])
  if not (a and b) then return nil end
  -- COMPAT 5.4: products of integers wrap around
  local value = OPERATORS[item.operator](a + 0.0, b + 0.0)
  return value - value == 0 and value or nil -- it may be too large
end

-- Return a kind with the parts of another, and its own.
local function like(base, own)
  local kind = {}
  for _, parts in ipairs { base, own } do
    for name, part in pairs(parts) do kind[name] = part end
  end
  return kind
end

-- Integers, which may be codes; numbers with a fraction or a special; texts.
local CODE = {
  shown = "plain",
  choose = choose_integer,
  info = code_info,
  column = "integer",
  cells = code_cells,
  remark = remark_code,
  source = code_source,
  is_number = true,
  is_integer = true,
}
local NUMBER = {
  filter = always("DOUBLE"),
  shown = "number",
  info = number_info,
  column = "float",
  cells = number_cells,
  remark = remark_special,
  is_number = true,
}
local TEXT = {
  choose = always(read_bytes),
  info = text_info,
  column = "string",
  cells = text_cells,
  is_text = true,
}

--- By the name of the kind:
--   filter   function(field) -> Wireshark's type of its filter, and the base or nil
--   shown    how show.taurus adds it to a tree: "plain" (Wireshark reads the bytes), "number",
--            "text", "time" or "flags"
--   choose   function(field) -> function(field, payload), which reads the raw value
--   value    function(field, raw) -> see M.value; nil where the raw is the value
--   number   function(field, raw) -> the value as a number, nil where M.value is one
--   info     function(field, shape) -> a function(raw) -> a text for Info; shape = for a fraction
--   column   type of its column in CSV and fields.json; unit = of a column without one of its own
--   cells    function(field) -> a function(raw) -> its cells in CSV
--   remark   function(field, raw, remarks), which appends to the list that decode.new_reader
--            describes, for a remarkable value; nil if no value can be one
--   source   its condition as source, see above: function(field, i)
--   code     format of a code in texts; nil: hexadecimal
--   is_number, is_integer, is_text
M.BY_NAME = {
  uint = like(CODE, { filter = sized("UINT", hexadecimal_if_enum) }),
  int = like(CODE, {
    filter = sized("INT", decimal),
    code = "%d", -- COMPAT 5.2: a negative number has no hexadecimal text
  }),
  -- value = count * scale + zero
  scaled = like(CODE, {
    filter = always("DOUBLE"),
    shown = "number",
    value = function(field, raw) return raw * field.scale + field.zero end,
    info = number_info,
    column = "float",
  }),
  bool = like(CODE, {
    filter = always("BOOLEAN"),
    info = always(function(raw) return BOOLS[raw] or format("invalid 0x%x", raw) end),
    column = "bool",
    cells = always(function(raw) return raw == 0 and "0" or "1" end),
    is_number = false,
  }),
  -- A compressed float.
  float = like(NUMBER, { choose = choose_float, value = float_value, source = float_source }),
  ieee = like(NUMBER, { choose = always(read_ieee), value = ieee_value, source = special_source }),
  flags = {
    filter = sized("UINT", hexadecimal),
    shown = "flags",
    choose = choose_integer,
    info = code_info,
    column = "integer",
    cells = flags_cells,
    remark = remark_flags,
    source = flags_source,
  },
  time = {
    filter = always("RELATIVE_TIME"),
    shown = "time",
    choose = always(read_bytes),
    number = time_number,
    info = always(function(raw) return time_text(raw) .. " s" end),
    column = "time",
    unit = "s",
    cells = always(time_text),
  },
  -- A text ends at its first NUL.  A character that cannot be shown is \xnn.
  string = like(TEXT, {
    filter = always("STRING"),
    shown = "text",
    value = function(_, raw) return utf8.value(raw:match("^%Z*")) end,
  }),
  bytes = like(TEXT, {
    filter = always("BYTES"),
    shown = "plain",
    value = function(_, raw) return (raw:gsub(".", hex_digits)) end,
  }),
  -- Worked out from two fields; its raw value is the list of all.
  derived = { column = "float", value = derived_value, cells = derived_cells, is_number = true },
}

--- Return a function(raw) -> the cells of a field in CSV.  It keeps the latest text: flags and the
-- like seldom change.
function M.cells_of(field)
  local write, latest, text = M.BY_NAME[field.kind].cells(field), nil, nil
  return function(raw)
    if raw ~= latest then latest, text = raw, write(raw) end
    return text
  end
end

--- Return whether a field, or an item of message.generated, has numbers that are no codes.
function M.is_number(field)
  return M.BY_NAME[field.kind].is_number and not field.values
end

--- Return the value of a field as a number: NaN where that is none, such as a reserved value.
function M.number(field, raw)
  local number = M.BY_NAME[field.kind].number
  if number then return number(field, raw) end
  return tonumber((M.value(field, raw))) or 0 / 0 -- of 64 bits a text, where a double is not exact
end

--- Return the highest raw value that is a number, of a field whose raw values are counts and whose
-- numbers grow in proportion to them: so that a mean of raw values gives the mean.  Nil for others.
function M.linear_top(field)
  local kind = field.kind
  local is_linear = kind == "float" or kind == "uint" or kind == "int" or
    kind == "scaled" and field.scale > 0
  if not is_linear or field.size > 6 then return nil end
  return field.ordinary or field.top
end

return M
]=])
module("yapp.message.history", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The history of each source: the changes from one good message to the next.  Pure Lua.
--
-- A source is a bus or stream, and an ID.  Changes are found once, in the order of the capture.
-- They are kept by the frame key of the message, so that a revisit gets the same.  In an only pass,
-- memory grows with changes, Commands and reboots, not with messages.

local band = require "yapp.base.bits".band
local binary = require "yapp.message.binary"
local last_until = require "yapp.base.frame_key".last_until
local faults_of = require "yapp.message.faults"
local memo = require "yapp.base.memo"

local M = {}

local huge, insert = math.huge, table.insert

local HALF_NANOSECOND = 5e-10 -- rounding error of a difference of two times
local MAX_JUMP = 1 + HALF_NANOSECOND -- seconds; the capture's clock may jitter by less
-- A Seq up to 8 behind came late, if it came within a second; it does not mean 248 missing.
local MAX_BEHIND, MAX_LATE = 8, 1

-- Evidence that several controllers share a source, see is_shared.  tests/unit/test_shared.lua has
-- the traces that the numbers tell apart: shared sources, reboots, late messages, stopped clocks.
local LARGE_FALL = 2 -- seconds; a message that came late makes the clock fall by less
local LARGE_RETURN = 50 -- evidence of a return from a large fall; from a small one it is 1
local FADE = 0.85 -- per message: evidence of 50 stays above ENOUGH for 22 messages
local ENOUGH = 1.3 -- two small returns a few messages apart, or a large one

local NO_TYPE = { flag_fields = {} }
-- Changes that many messages have in common: to be read only.
local SHARED = { shared = true, unreliable = true }
local UNRELIABLE = { unreliable = true }

local History = {}
History.__index = History

--- Make the history of one pass over one capture.
-- options  { catalogue = compiled,
--            late = periods of a message that a gap must exceed to be late,
--            buses = a host.buses, asked whether the capture lacks times or a clock }
function M.new(options)
  local self = setmetatable({
    options = options,
    by_source = {}, -- [source] = see new_source
    commands = {}, -- [name of a message that others answer][bus or false] = frame keys, ascending
    deltas = {}, -- [frame key] = seconds since the source's previous good message, or false
  }, History)
  for _, of_type in ipairs(options.catalogue.messages) do
    if of_type.answers then self.commands[of_type.answers] = memo(function() return {} end) end
  end
  return self
end

local function new_source(self, message)
  local of_type, bus = message.source.message or NO_TYPE, message.source.bus_key or false
  local options, answered = self.options, self.commands[of_type.answers]
  local has_times = not options.buses:lacks_times()
  local answering = self.commands[of_type.name]
  return {
    -- Its message type:
    flag_fields = of_type.flag_fields,
    period = of_type.every or 0,
    longest = has_times and options.late * (of_type.every or huge) + HALF_NANOSECOND or huge,
    has_times = has_times,
    has_clock = not options.buses:lacks_clock(),
    -- The previous good message:
    time = nil, -- seconds of the capture
    seq = nil, -- the newest
    flags = {}, -- [index of a flags field] = raw value
    -- The previous good message with a clock:
    clock = nil, -- the controller's, nanoseconds
    clock_time = nil, -- seconds of the capture
    payload = nil,
    -- Since then:
    faults = faults_of.new(),
    -- See is_shared.  The controller's clock falls when it goes back or stops.  Later it may return
    -- to the lead over the capture's clock that it had before the fall.
    lead = 0, -- seconds that it gained on the capture's clock since its first fall
    falls = {}, -- { lead before it, size }, the latest first; none from which the clock returned
    evidence = 0,
    shared_key = huge, -- frame key of the message that proves that controllers share the source
    -- By the frame key of a message:
    changes = {}, -- [frame key] = change
    base_keys = {}, -- ascending: the first clock, and reboots
    bases = {}, -- of each: seconds of the controller's clock less the capture's
    fault_keys = {}, -- ascending: where faults change
    active_since = {}, -- of each: when the oldest fault that is still set was raised, or false
    incidents = {}, -- of each: { first, last = frame keys }, from the first fault to none
    commands = answered and answered[bus], -- ascending: the messages that they answer
    own = answering and answering[bus], -- ascending: if others answer them
  }
end

-- Clocks -----------------------------------------------------------------------------------------

-- Return the controller's clock in nanoseconds, exact up to 104 days (2^53 ns); nil for a message
-- without one.
local function clock_of(message)
  local field = message.raws and message.source.message.time
  if not field or #message.payload < field.offset + 8 then return nil end
  local seconds, nanoseconds = binary.time(message.payload, field.offset)
  return seconds * 1e9 + nanoseconds
end

-- Add evidence if the clock is back where it would be without a fall.
local function note_return(source)
  for i, fall in ipairs(source.falls) do
    if math.abs(source.lead - fall.lead) <= math.min(fall.size, LARGE_FALL) / 4 then
      source.evidence = source.evidence + (fall.size < LARGE_FALL and 1 or LARGE_RETURN)
      table.remove(source.falls, i)
      return
    end
  end
end

-- Return whether a message proves that several controllers share its source.  Their clocks
-- alternate:
--   100.0, 7.2, 100.1, 7.3      it falls by 92.8, returns to where it would be, falls: proved
--   100.0, 99.8, 100.1, 99.9    small falls: a late message makes one, so a third one proves it
--   100.0, 100.0, 100.1, 100.1  the same clock again within a third of a period is a fall, too: a
--                               large one, or a small one if the whole message is the same
-- After a reboot, the clock does not return.  A clock that stops is the same after a whole period.
-- advance, elapsed  seconds of the controller's and of the capture's clock since source.clock
local function is_shared(source, message, advance, elapsed)
  local lead, falls, size = source.lead, source.falls, elapsed - advance
  source.lead = lead - size
  source.evidence = source.evidence * FADE
  if advance > 0 then
    note_return(source)
    return false
  elseif advance == 0 then
    if elapsed >= source.period / 3 then return false end
    size = message.payload == source.payload and source.period or LARGE_FALL
  end
  insert(falls, 1, { lead = lead, size = size })
  falls[5] = nil -- up to four controllers fall from one to the next before they return
  return source.evidence > ENOUGH
end

-- Return the seconds of the capture's clock since source.clock.  If it has none, trust the
-- controller's clock unless that jumps: then take the message to come after a period.
local function elapsed_since(source, message, advance)
  if source.has_clock then return message.time - source.clock_time end
  return advance > 0 and advance <= MAX_JUMP and advance or source.period
end

-- Return the change of the controller's clock: its name and its value; nil for nothing.
local function clock_change(source, message, clock)
  local advance = (clock - source.clock) / 1e9
  local elapsed = elapsed_since(source, message, advance)
  local may_be_shared = advance <= 0 or source.lead ~= 0
  if may_be_shared and is_shared(source, message, advance, math.max(elapsed, 0)) then
    return "shared", true
  end
  if advance < 0 then return "reboot", -advance end
  if advance == 0 then return "stale", true end
  local jump = advance - elapsed
  -- If the capture's own clock went back, it is no measure of the controller's.
  if jump > MAX_JUMP and elapsed >= 0 and source.has_clock then return "jump", jump end
end

-- Flags ------------------------------------------------------------------------------------------

-- Return the change of a flags field, nil for nothing.  In a source's first message, faults that
-- are set count as raised.
local function flag_change(field, before, now)
  before = before or now - band(now, field.alarm_bits)
  local both = band(before, now)
  local raised, cleared = band(now - both, field.watched), band(before - both, field.watched)
  if raised == 0 and cleared == 0 then return nil end
  return {
    field = field,
    value = now,
    raised = raised,
    cleared = cleared,
  }
end

-- Detectors --------------------------------------------------------------------------------------
--
-- A detector is a function(source, message, delta, change), which returns the name of a change and
-- its value, nil for nothing:
--   delta   seconds since the source's previous good message, false for the first
--   change  of the detectors before it, nil for nothing

-- "shared", "reboot", "stale" or "jump": the controller's clock.
local function detect_clock(source, message)
  local clock, name, value = clock_of(message), nil, nil
  if not clock then return nil end
  if source.clock then name, value = clock_change(source, message, clock) end
  if source.has_times and (name == "reboot" or not source.clock) then
    insert(source.base_keys, message.key)
    insert(source.bases, clock / 1e9 - message.time)
  end
  source.clock, source.clock_time, source.payload = clock, message.time, message.payload
  return name, value
end

-- "flags": the fields whose flags change.
local function detect_flags(source, message)
  local raws, flags, fields, changes = message.raws, source.flags, source.flag_fields, nil
  if not raws then return nil end
  for i = 1, #fields do
    local field = fields[i]
    local index = field.index
    local now, before = raws[index], flags[index]
    if now and now ~= before then
      flags[index] = now
      local change = flag_change(field, before, now)
      if change then
        changes = changes or {}
        insert(changes, change)
      end
    end
  end
  return changes and "flags", changes
end

-- "faults": those among these flags that rise or fall.
local function detect_faults(source, message, _, change)
  local flags = change and change.flags
  local steps = flags and source.faults:update(flags, message.time)
  if not steps then return nil end
  local keys, incidents, key = source.fault_keys, source.incidents, message.key
  if keys[#keys] ~= key then
    local is_first = not source.active_since[#keys]
    insert(keys, key)
    incidents[#keys] = is_first and { first = key } or incidents[#keys - 1]
  end
  local oldest = source.faults:oldest_time()
  source.active_since[#keys], incidents[#keys].last = oldest, not oldest and key or nil
  return "faults", steps
end

-- "missing": how many messages Seq No says are missing: 7, 9 is one.  A source that does not number
-- its messages repeats its Seq.  7, 9, 8, 10 is one, at 9: 8 came late.  After a reboot, numbers
-- begin anew.
local function detect_missing(source, message, delta, change)
  local seq, fall = message.seq, change and change.reboot or 0
  local ahead = (seq - (source.seq or seq)) % 256
  local is_late = ahead >= 256 - MAX_BEHIND and fall < LARGE_FALL and (delta or 0) <= MAX_LATE
  if is_late then return nil end
  source.seq = seq
  if ahead > 1 and fall == 0 then return "missing", ahead - 1 end
end

-- "late": the length of a gap that is longer than it may be.
local function detect_late(source, _, delta)
  if delta and delta > source.longest then return "late", delta end
end

-- The detectors, in the order in which they need each other.  A new change is one of them, a row of
-- stat.kinds (its event) and a row of show.fields (its expert item).
local DETECTORS = { detect_clock, detect_flags, detect_faults, detect_missing, detect_late }

-- Return the change of a good message, nil for none.
local function update(source, message, delta)
  local change = nil
  for i = 1, #DETECTORS do
    local name, value = DETECTORS[i](source, message, delta, change)
    if name then
      change = change or {}
      change[name] = value
    end
  end
  local key = message.key
  if change and change.shared then source.shared_key, change = key, SHARED end
  if change or source.changes[key] then source.changes[key] = change end
  return change
end

--- Add the next message, in the order of the capture.
-- is_only_pass  whether it is sure that it is not revisited
-- message  { source = of message.types; raws = by index of field, nil if the payload does not fit;
--          payload, seq, status; key = frame key: never falls; an equal one replaces a message;
--          time = seconds of the capture }
-- returns  its change, nil if the message is not good or changes nothing: {
--   missing  how many messages are missing before it by Seq
--   late     seconds since the previous one, if that is more than options.late periods
--   reboot   seconds by which the controller's clock went back
--   jump     seconds by which it advanced more than the capture's, if more than one
--   stale    true if it did not advance
--   flags    list of { field, value, raised = mask, cleared = mask } of the fields whose flags
--            changed
--   faults   of these flags the faults that rise or fall, see message.faults
--   shared   true at the message that proves that several controllers share the source
--   unreliable  true at the messages behind that one, which get nothing else }
--          and the seconds since the source's previous good message, false for the first
function History:add(message, is_only_pass)
  local source = self.by_source[message.source]
  if not source then
    source = new_source(self, message)
    self.by_source[message.source] = source
  end
  local delta = source.time and message.time - source.time or false
  if not is_only_pass then self.deltas[message.key] = delta end
  if message.status ~= "good" then return nil, delta end
  source.time = message.time
  if source.own then insert(source.own, message.key) end
  if message.key > source.shared_key then return UNRELIABLE, delta end
  return update(source, message, delta), delta
end

--- Return the results of History:add, at any later time and in any order; nil and nil for a
-- message that was not added.
-- message  as it was added
function History:change(message)
  local source, key = self.by_source[message.source], message.key
  local delta = self.deltas[key]
  if not source or message.status ~= "good" then return nil, delta end
  return key > source.shared_key and UNRELIABLE or source.changes[key], delta
end

-- Return the seconds from one time to another, nil if the capture's clock went back behind that.
local function span(from, to)
  return from <= to and to - from or nil
end

--- Return the state at a message, whether the message changes it or not.
-- message        as it was added
-- returns  nil if message is not good, or its source is not known or unreliable, else {
--   drift         seconds: controller's clock less the capture's, since the source's first message
--                 or reboot
--   command_in    frame key of the latest good message on the bus that it answers: a Command
--   active_time   seconds since the oldest fault that is still set was raised; nil if the capture's
--                 clock went back behind that
--   raised_in, cleared_in  frame keys of the messages in which the time with a fault began and
--                 ended, if one is set or changes
--   previous_change, next_change  of the messages before and behind it that changed a fault, then }
function History:state(message)
  local source, key = self.by_source[message.source], message.key
  if not source or message.status ~= "good" or key >= source.shared_key then return nil end
  local base = source.bases[last_until(source.base_keys, key)]
  local clock, commands, faults = base and clock_of(message), source.commands, source.fault_keys
  local last = last_until(faults, key)
  local since, is_change = source.active_since[last], faults[last] == key
  local state = {
    drift = clock and clock / 1e9 - message.time - base,
    command_in = commands and commands[last_until(commands, key - 1)],
    active_time = since and span(since, message.time),
  }
  if since or is_change then
    state.raised_in, state.cleared_in = source.incidents[last].first, source.incidents[last].last
    state.previous_change = faults[is_change and last - 1 or last]
    state.next_change = faults[last + 1]
  end
  return state
end

return M
]=])
module("yapp.message.sources", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The preference yapp.sources: which names the user gave to sources.  Pure Lua.
--
--   0x210=motor:left_fore, can1/0x210=motor:right_fore, can0/0x210+0x200+0x000=left, can2=tail
--   0x213=motor:, can0/0x210-0x213=motor:M1..M4
--
-- A part is [BUS/]ID[+ID...]=[MESSAGE:]NAME, or BUS=NAME for every ID of a bus.  A range of IDs may
-- stand for an ID, 0x210-0x213; its names count up, M1..M4.  BUS is the name that the capture gives
-- a bus.  ID is decimal, or 0x and hexadecimal.  MESSAGE is the catalogue's short name of what the
-- ID carries.  A part without BUS is for each bus without a part of its own.  Spaces around each do
-- not count.
-- A bus stands in quotes if its name has a comma, "=" or a quote, or if it begins with a digit and
-- no ID follows.  Its own quotes are doubled: "USB, left"/0x210=motor:a.
-- The last "/" ends the bus: vcan/0/0x210 is ID 0x210 on vcan/0.
-- A sender in UDP or TCP is a bus, 192.168.1.12:40000 or [fe80::1]:14550.  Without its port the
-- part holds for all ports.  Without its direction, #rx or #tx, a line's name holds for both.

local input = require "yapp.base.input"
local memo = require "yapp.base.memo"
local utf8 = require "yapp.base.utf8"

local M = {}

local trim = input.trim

local MAX_NAME = 64 -- bytes
local SHAPE = "write [BUS/]ID=[MESSAGE:]NAME or BUS=NAME"

local Sources = {}
Sources.__index = Sources

-- Signs between quotes are hidden while a text is taken apart.
local HIDDEN = { [","] = "\0c", ["="] = "\0e", ["/"] = "\0s" }
local SHOWN = { c = ",", e = "=", s = "/" }

local function hide(quoted)
  return (quoted:gsub("[,=/]", HIDDEN))
end

local function reveal(text)
  return (text:gsub("\0(.)", SHOWN))
end

-- Raise a problem and an advice unless a condition holds.
local function demand(condition, problem, advice)
  if not condition then error({ problem = problem, advice = advice }, 0) end
end

-- Take a part apart at its "=".
-- returns  the bus or nil, the text of the IDs or nil, and the text behind the "="
local function take_address(part)
  local address, value = part:match("^(.-)%s*=(.*)$")
  demand(address, 'no "="', SHAPE)
  value = reveal(value)
  if address:find("^[%d+-][^/]*$") then return nil, address, value end
  local bus, ids = address:match("^(.*)/([^/]*)$")
  bus = trim(bus or address)
  if bus:sub(1, 1) == '"' then
    local quoted = bus:match('^"(.*)"$')
    demand(quoted, 'no "/" or "=" behind the quotes', SHAPE)
    bus = reveal(quoted):gsub('""', '"')
  end
  demand(bus ~= "", "no bus or ID", SHAPE)
  return bus, ids, value
end

local function read_id(text)
  local digits = trim(text)
  local id = (digits:find("^%d+$") or digits:find("^0[xX]%x+$")) and tonumber(digits)
  demand(id and id <= input.MAX_ID, ('no ID "%s"'):format(digits), "IDs are 0 to 0x7FF")
  return id
end

-- Return a list of ranges { first, last }; of a single ID both are the same.
local function read_ids(text)
  local ranges = {}
  for part in (text .. "+"):gmatch("([^+]*)%+") do
    local first, last = part:match("^([^-]+)%-([^-]+)$")
    local range = { read_id(first or part), read_id(last or part) }
    demand(range[1] <= range[2], ('no ID in "%s"'):format(trim(part)), "write the lower ID first")
    ranges[#ranges + 1] = range
  end
  return ranges
end

-- Return the names of the IDs of each range, M1..M4 for four; nil for a name without "..".
local function take_names(name, ranges)
  local stem, first, other, last = name:match("^(.-)(%d+)%.%.(.-)(%d+)$")
  if not stem or stem ~= other or #last > 4 then return nil end
  local names, shape = {}, "%s%0" .. #first .. "d" -- M08..M11 are M08, M09, M10, M11
  for number = tonumber(first), tonumber(last) do names[#names + 1] = shape:format(stem, number) end
  for _, range in ipairs(ranges) do
    local count = range[2] - range[1] + 1
    demand(#names == count, ("number of names is %d, of IDs %d"):format(#names, count),
      "write one name for each ID: 0x210-0x213=M1..M4")
  end
  return names
end

-- Raise that no sender has such an address: a byte above 255, or a port above 65,535.
local function check_address(bus)
  local a, b, c, d, port = bus:match("^(%d+)%.(%d+)%.(%d+)%.(%d+):?(%d*)$")
  port = port or bus:match("^%[.*:.*%]:(%d+)$")
  local is_possible = (tonumber(port) or 0) < 65536
  for _, byte in ipairs { a, b, c, d } do is_possible = is_possible and tonumber(byte) < 256 end
  local advice = "write 192.168.1.12:40000 or [fe80::1]:14550"
  demand(is_possible, ('no address "%s"'):format(bus), advice)
end

-- Read a part.
-- returns  the bus, the ranges of IDs, the compiled message and the name: nil for each that it does
--          not say
local function read_part(part, catalogue)
  local bus, id_text, value = take_address(part)
  local ids = id_text and read_ids(id_text)
  local message_name, name = value:match("^(.-):(.*)$")
  name = trim(name or value)
  demand(not name:find(";.*="), "a semicolon", "separate sources by commas")
  demand(#name <= MAX_NAME, "a long name", ("the longest has %d bytes"):format(MAX_NAME))
  demand(name == "" or input.is_text(name), "a name that cannot be shown", "use letters")
  if not message_name then
    demand(name ~= "", "no name", SHAPE)
    return bus, ids, nil, name
  end
  demand(ids, "a message for a whole bus", "name its ID, too")
  message_name = trim(message_name)
  local message, known = input.find(catalogue.messages, message_name)
  demand(message, ('no message "%s"'):format(message_name), "known messages: " .. (known or ""))
  return bus, ids, message, name ~= "" and name or nil
end

-- Add a row for an ID, or for all of a bus; return whether an earlier part has it.
local function add_row(self, bus, id, message, name)
  local of_bus = self.by_bus[bus or false]
  if of_bus[id or "every"] then return true end
  local row = { bus = bus, id = id, message = message, name = name }
  of_bus[id or "every"] = row
  self.rows[#self.rows + 1] = row
end

-- Add the rows of a part; raise if an earlier part has one.
local function add_part(self, part, catalogue)
  local bus, ranges, message, name = read_part(part, catalogue)
  local names, is_repeated = ranges and take_names(name or "", ranges), false
  if bus then check_address(bus) end
  if not ranges then is_repeated = add_row(self, bus, nil, nil, name) end
  for _, range in ipairs(ranges or {}) do
    for id = range[1], range[2] do
      local own = names and names[id - range[1] + 1] or name
      is_repeated = add_row(self, bus, id, message, own) or is_repeated
    end
  end
  demand(not is_repeated, "a bus and ID once more", "the first part that names them holds")
end

--- Return the address of an ID, the text before the "=" of a part: can1/0x210, "a,b"/0x210.
-- bus  name, or nil; id = message ID
function M.address(bus, id)
  if bus and bus:find('[,="%s]') then bus = '"' .. bus:gsub('"', '""') .. '"' end
  return ("%s0x%x"):format(bus and bus .. "/" or "", id)
end

--- Read the preference.
-- text       of the user
-- catalogue  compiled
-- returns    the sources; and a list of errors: a part that cannot be read is left
--            out, the others hold
function M.parse(text, catalogue)
  local by_bus, problems = memo(function() return {} end), {} -- [bus or false][ID] = a row
  local self = setmetatable({ by_bus = by_bus, rows = {} }, Sources)
  local hidden = text:gsub('"[^"]*"', hide)
  for piece in hidden:gmatch("[^,]+") do
    local part = trim(piece)
    local ok, wrong = true, nil
    if part ~= "" then ok, wrong = pcall(add_part, self, part, catalogue) end
    if not ok then
      local where = reveal(part)
      local problem = ('yapp.sources: %s in "%s"; %s'):format(wrong.problem, where, wrong.advice)
      problems[#problems + 1] = utf8.printable(problem)
    end
  end
  return self, input.few(problems)
end

-- Return a name that a bus has together with others, nil for none.
local function wider(bus)
  return bus:match("^(.+)#[rt]x$") or bus:match("^(%d+%.%d+%.%d+%.%d+):%d+$") or
    bus:match("^(%[.+%]):%d+$") or bus:match("^%[(.+)%]$")
end

-- Return the rows by ID that hold for a bus: a list, those of its own name first.
local function rows_of(self, bus, interface)
  local list = {}
  while bus do
    list[#list + 1], bus = self.by_bus[bus], wider(bus)
  end
  if interface then list[#list + 1] = self.by_bus[interface] end
  return list
end

--- Return the name of a source, nil where the user gave none: that of its ID on its bus, of its
-- bus, or of its ID anywhere.
-- bus        the name that the capture gives it, or nil
-- id         message ID
-- interface  of a sender in UDP or TCP: the name of the interface, or nil
function Sources:name(bus, id, interface)
  local has_own = false
  for _, of_bus in ipairs(rows_of(self, bus, interface)) do
    local own, of_every_id = of_bus[id], of_bus.every
    if own and own.name then return own.name end
    if of_every_id then return of_every_id.name end
    has_own = has_own or own ~= nil
  end
  local anywhere = not has_own and self.by_bus[false][id]
  return anywhere and anywhere.name or nil
end

--- Return the compiled message that the user said an ID carries on a bus; nil where the preference
-- says nothing of it.
-- bus, id, interface  as of Sources:name
function Sources:message(bus, id, interface)
  for _, of_bus in ipairs(bus and rows_of(self, bus, interface) or {}) do
    if of_bus[id] then return of_bus[id].message end
  end
  local row = self.by_bus[false][id]
  return row and row.message
end

--- Return whether a part is about an ID on a bus, or on a bus with a name that includes that one.
-- bus  name, nil for a part without a bus
function Sources:has_part(bus, id)
  for _, of_bus in ipairs(bus and rows_of(self, bus) or { self.by_bus[false] }) do
    if of_bus[id] then return true end
  end
  return false
end

--- Return all that was read: a list of { bus = name or nil, id = nil for all of a bus, message =
-- compiled or nil, name = or nil }.
function Sources:list()
  return self.rows
end

return M
]=])
module("yapp.message.text", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- A message as a text: its values in the Info column, and a row of CSV.  Pure Lua.
--
-- In CSV an enum is its number and, in NAME_text, its meaning; flags are the integer and, in
-- GROUP_FLAG, 0 or 1; a float with a reserved value is an empty cell, and NAME_special names the
-- value.

local band = require "yapp.base.bits".band
local field_kinds = require "yapp.message.field_kinds"
local input = require "yapp.base.input"
local memo = require "yapp.base.memo"

local M = {}

local format, concat = string.format, table.concat
local KINDS = field_kinds.BY_NAME

-- Writers ----------------------------------------------------------------------------------------

-- A message is written in pieces: texts, and tables {
--   index   of a field; nil for a value that is worked out from all raws
--   field
--   write   function(raw) -> text; where index is nil, it takes all raws
--   absent  the text of a missing field
--   shape   a format for the value of a compressed float, or of two, see value_source; else false }

local MAX_PIECES = 100 -- of a usual message: a function has up to 200 local variables
local SOURCE = [[
local WRITE, SHAPE, format, write_slowly = ...
return function(raws)
%s
return format(%s)
end]]

-- Return the value of a compressed float as source, see field_kinds.value; also of a value that is
-- worked out from two of them.  Nil for others.
-- raws  [field] = the name of its raw value
local function value_source(field, raws)
  if field.kind == "derived" then
    local a, b = value_source(field.a, raws), value_source(field.b, raws)
    return a and b and format("%s %s %s", a, field.operator, b)
  end
  if field.kind ~= "float" or not raws[field] then return nil end
  local steps, span = field.top - field_kinds.below_top, field.max - field.min
  return format("((%.17e + %s * %.17e) / %.17e)", field.min * steps, raws[field], span, steps)
end

-- Write the pieces one by one.
local function write_each(pieces, raws)
  local texts = {}
  for i, piece in ipairs(pieces) do
    local text = piece
    if type(piece) == "table" then
      local raw = raws
      if piece.index then raw = raws[piece.index] end
      text = raw and piece.write(raw) or piece.absent
    end
    texts[i] = text
  end
  return concat(texts)
end

-- Return a piece as source: a line that has its raw value, and the value to format.
-- index  of the piece
-- raws   [field] = the name of its raw value, of the pieces before it
local function piece_source(piece, index, raws)
  local field, name = piece.field, "a" .. index
  local raw = piece.index and format("raws[%d]", piece.index) or "raws"
  local condition, value = "not " .. name, format("WRITE[%d](%s)", index, name)
  if piece.index then raws[field] = name end
  local source = piece.shape and value_source(field, raws)
  if source and piece.index then
    condition = format("%s or %s < 0 or %s > %.0f", condition, name, name, field.ordinary)
    value = source
  elseif source then -- the value may be too large
    raw, condition, value = source, format("%s - %s ~= 0", name, name), name
  end
  local line = "local %s = %s if %s then return write_slowly(raws) end"
  return format(line, name, raw, condition), value, source and piece.shape or "%s"
end

-- Make a function(raws) -> text that writes a usual message, which has all fields and no reserved
-- value, at once.  It is made from Lua source: a loop over the pieces would make a packet list 6 %
-- slower, and a table 13 %.
local function new_writer(pieces)
  local function write_slowly(raws) return write_each(pieces, raws) end
  if #pieces > MAX_PIECES then return write_slowly end
  local lines, writes, values, shapes, raws = {}, {}, { "SHAPE" }, {}, {}
  for i, piece in ipairs(pieces) do
    if type(piece) == "string" then
      shapes[i] = piece:gsub("%%", "%%%%")
    else
      writes[i] = piece.write
      lines[#lines + 1], values[#values + 1], shapes[i] = piece_source(piece, i, raws)
    end
  end
  local source = format(SOURCE, concat(lines, "\n"), concat(values, ", "))
  return load(source, "=writer")(writes, concat(shapes), format, write_slowly)
end

--- Return the function(raws) -> text that writes pieces: of M.compile_info, or of a row.
function M.writer_of(pieces)
  if pieces.below_top ~= field_kinds.below_top then -- the user may choose another divisor
    pieces.below_top, pieces.write = field_kinds.below_top, new_writer(pieces)
  end
  return pieces.write
end

-- The Info column --------------------------------------------------------------------------------

-- Return the piece of a field, and " V" if its unit follows, else nil.
-- rest  the text behind its name: ":%.1f unit"
local function info_piece(message, name, rest)
  local field = message.by_name[name]
  input.demand(field, "info names a field %s that is not there", input.shown(name))
  local before = rest:match("^(.-) unit$")
  local shape = (before or rest):gsub("^:", "")
  input.demand(not before or field.unit, "info: %s has no unit", name)
  local is_real = field.special or field.scale
  input.demand(shape == "" or is_real and shape:find("^%%%.?%d?[fg]$"),
    "info: the format %s is not one for %s", input.shown(shape), name)
  if shape == "" then shape = is_real and "%.4g" end
  return {
    field = field,
    index = field.index,
    shape = field.kind == "float" and shape,
    write = KINDS[field.kind].info(field, shape),
    absent = "-",
  }, before and " " .. field.unit
end

--- Compile the text of a message's values in Info.
-- text     "{name:%.1f unit}" is "47.3 V"; "{name}" is without the unit, and with as many digits as
--          make sense
-- returns  what M.writer_of takes.  It raises errors.
function M.compile_info(message, text)
  local pieces, index = {}, 1
  while index do
    local from, to, name, rest = text:find("{([%w_]+)([^}]*)}", index)
    local unit = nil
    pieces[#pieces + 1] = text:sub(index, (from or 0) - 1)
    if from then pieces[#pieces + 1], unit = info_piece(message, name, rest) end
    pieces[#pieces + 1] = unit or nil
    index = to and to + 1
  end
  return pieces
end

--- Return the filter names of the flags that are set, undefined bits as one number:
-- "motor_overcurrent, hall_timeout, undefined 0x80000".
function M.flag_names(field, raw)
  if raw == field.named then return field.names end -- cached: they seldom change
  local names = {}
  for _, flag in ipairs(field.flags) do
    if band(raw, flag.mask) ~= 0 then names[#names + 1] = flag.name end
  end
  local undefined = band(raw, field.undefined)
  if undefined ~= 0 then names[#names + 1] = format("undefined 0x%x", undefined) end
  field.named, field.names = raw, concat(names, ", ")
  return field.names
end

--- Return the names of the fault flags that are set, "" for none.
-- raw  nil where the payload does not have the field
function M.fault_names(field, raw)
  return M.flag_names(field, band(raw or 0, field.alarm_bits))
end

--- Return the text of the Info column about the faults that are set:
-- "FAULT motor_overcurrent, faulted", "" for none.
-- raws  of the message's reader
function M.faults(message, raws)
  local text, word = "", nil
  for _, field in ipairs(message.alarms) do
    local names = M.fault_names(field, raws[field.index])
    if names ~= "" then
      local before = ", "
      if field.fault_word ~= word then before = (word and "  " or "") .. field.fault_word .. " " end
      text = text .. before .. names
      word = field.fault_word
    end
  end
  return text
end

-- CSV --------------------------------------------------------------------------------------------

-- Names of columns that stat.csv puts in front of a message's own.
local TAKEN = { "time", "frame", "bus", "source", "id", "seq", "crc_good" }

-- Return the columns of a field or derived value, { name, type, flag or nil } each.
local function columns_of(field)
  local columns = { { field.name, KINDS[field.kind].column } }
  if field.special then columns[2] = { field.name .. "_special", "string" } end
  if field.values then columns[2] = { field.name .. "_text", "string" } end
  for i, flag in ipairs(field.flags or {}) do
    columns[i + 1] = { field.group:match("[^.]+$") .. "_" .. flag.name, "bool", flag }
  end
  return columns
end

-- Call visit(field, its columns) for the fields and derived values of a message.
local function each(message, visit)
  for _, list in ipairs { message.fields, message.derived } do
    for _, field in ipairs(list) do visit(field, columns_of(field)) end
  end
end

--- List the columns of a message, in order.
-- returns  a list of { name =, unit = or nil, type = "float", "integer", "bool", "string" or "time"
--          (seconds), field = or item of message.derived, flag = for the column of a flag }; a name
--          that another column has already ("time", "id") gets "_2" behind it
function M.columns(message)
  local columns, taken = {}, {}
  for _, name in ipairs(TAKEN) do taken[name] = true end
  each(message, function(field, list)
    for i, column in ipairs(list) do
      local name, count = column[1], 1
      while taken[name] do
        count = count + 1
        name = column[1] .. "_" .. count
      end
      taken[name] = true
      columns[#columns + 1] = {
        name = name,
        unit = i == 1 and (field.unit or KINDS[field.kind].unit) or nil,
        type = column[2],
        field = field,
        flag = column[3],
      }
    end
  end)
  return columns
end

-- [message] = the pieces of its cells
local rows = memo(function(message)
  local pieces = {}
  each(message, function(field, columns)
    if pieces[1] then pieces[#pieces + 1] = "," end
    pieces[#pieces + 1] = {
      field = field,
      index = field.index,
      shape = field.kind == "float" and field.shape .. "," or
        field.kind == "derived" and field.shape,
      write = field_kinds.cells_of(field),
      absent = (","):rep(#columns - 1),
    }
  end)
  return pieces
end)

--- Return the cells of a message, joined by commas, in the order of its columns; quoted where they
-- must be, empty for fields that are absent.
-- raws  of its reader
function M.row(message, raws)
  return M.writer_of(rows[message])(raws)
end

return M
]=])
module("yapp.message.types", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- Which message type an ID carries on a bus, and what its source is called, as the user's
-- preferences have it.  Pure Lua.

local text_of = require "yapp.message.text"

local M = {}

local NONE = {}

local Types = {}
Types.__index = Types

--- Make the types of a catalogue, before preferences are known.
-- catalogue  compiled
function M.new(catalogue)
  return setmetatable({
    messages = catalogue.messages, -- the message types
    by_id = catalogue.by_id, -- [id] = message type, see Types:use; file readers may ask before
    sources = nil, -- the names that the user gave, see Types:use
    several_ids = nil, -- [message type] = whether more than one ID carries it
    hidden = {}, -- see Types:use
    has_several = false, -- see Types:reset
  }, Types)
end

--- Forget the capture file.
-- has_several  whether the next one has several buses: then the name of a source includes its bus
function Types:reset(has_several)
  self.has_several = has_several
end

--- Use the user's choice of IDs and names.
-- by_id         { [id] = message type }
-- sources       a message.sources
-- hidden        parts that columns show instead of Info: { source, values = booleans }
-- visit         function(id), called for each ID that carries a message type
function Types:use(by_id, sources, hidden, visit)
  self.by_id, self.sources, self.hidden = by_id, sources, hidden
  local first, several = {}, {}
  local function count(message, id)
    visit(id)
    first[message] = first[message] or id
    if first[message] ~= id then several[message] = true end
  end
  for _, row in ipairs(sources:list()) do
    if row.message then count(row.message, row.id) end
  end
  for id in pairs(by_id) do count(self:message_of(id), id) end
  self.several_ids = several
end

--- Return the message type that an ID carries on a bus, nil for none.
-- bus        name, nil where the capture has none
-- interface  of a sender in UDP or TCP, or nil
function Types:message_of(id, bus, interface)
  return self.sources and self.sources:message(bus, id, interface) or self.by_id[id]
end

--- Return the payload size of that type and the smallest that it may have, nil for none.
function Types:size_of(id)
  local message = self:message_of(id)
  if message then return message.size, message.min_size end
end

-- Return the title of an ID's message type: "Motor Data", or "ID 0x123".
local function title_of(message, id)
  return message and message.title or ("ID 0x%x"):format(id)
end

-- Return the function that writes the values in Info, nil without a message type.
local function write_of(message, hides_values)
  return message and text_of.writer_of(hides_values and message.info_rest or message.info)
end

-- Return what a message is called: its title and the name of its source.  Without a name, the ID or
-- bus follows if it tells the source from others: "Motor Data left", "Motor Data 0x212 (can1)",
-- "Motor Data", "ID 0x123".
local function label_of(self, message, name, id, bus)
  local title, needs_bus = title_of(message, id), self.has_several and bus
  local is_usual = not message or id == message.id and not self.several_ids[message]
  if is_usual and not (name or needs_bus) then return title end
  if name then return title .. " " .. name end
  return title .. (message and (" 0x%x"):format(id) or "") .. (bus and (" (%s)"):format(bus) or "")
end

-- Return what the column Source has without a name: "can1 0x210", "10.0.0.1:14550 0x210", "0x210".
local function column_text(self, id, bus, line)
  local before = line and line.label or not line and self.has_several and bus
  return (before and before .. " " or "") .. ("0x%x"):format(id)
end

--- Make a source, which is a bus or stream, and an ID.
-- bus_key  of the bus or stream, or false
-- bus      its name, nil if the capture names none
-- line     of a stream, see serial.lines; nil on CAN
-- returns  {
--   id, bus, bus_key, line
--   name      that the user gave it, or nil
--   message   the message type that it carries, or nil; size, min_size = of its payload, or nil
--   label     the name of its messages
--   short     the same without the source, if a column shows that
--   write     function(raws) -> the values in Info, nil without a message type
--   text      for the column Source: the name, else bus and ID, where they differ from others'
--   texts     of the fragments of its messages, see show.frame }
function Types:new_source(id, bus_key, bus, line)
  local interface = line and line.interface or nil
  local message = self:message_of(id, bus, interface)
  local name = self.sources:name(bus, id, interface)
  local label = label_of(self, message, name, id, bus)
  return {
    id = id,
    bus = bus,
    bus_key = bus_key,
    line = line,
    name = name,
    message = message,
    size = (message or NONE).size,
    min_size = (message or NONE).min_size,
    label = label,
    short = self.hidden.source and title_of(message, id) or label,
    write = write_of(message, self.hidden.values),
    text = name or column_text(self, id, bus, line),
    texts = {},
  }
end

return M
]=])
module("yapp.reading.copies", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- Finds messages that the recorder holds twice: its own sends and what it hears, `-i any`, a mirror
-- port, a radio that repeats.  Pure Lua.
--
-- A copy has the bytes of an earlier message of its source, and comes less than 20 ms and less than
-- half a period after it: a controller that hangs repeats its bytes after a whole period.  Without
-- times of packets nothing is a copy.

local M = {}

local abs, max, min = math.abs, math.max, math.min
local MAX_DISTANCE = 0.02 -- seconds
local HALF_NANOSECOND = 5e-10 -- rounding error of a difference of two times
local MAX_KEPT = 16 -- messages of a source within this time

local Copies = {}
Copies.__index = Copies

--- Make the finder of one capture.
-- buses  a host.buses, asked whether the capture lacks times or a clock
function M.new(buses)
  return setmetatable({
    is_timed = not buses:lacks_clock(),
    -- If not, at the time of the first packet it is not known yet whether times advance.
    stamps_differ = buses:stamps_differ(),
    -- [source] = list of its latest messages that are no copies, and
    --   start   when the first one came
    --   others  when other sources' latest messages came, see stands_still; nil until it is asked
    by_source = {},
    originals = {}, -- [frame key of a copy] = that of its original, for revisits
  }, Copies)
end

-- The CRC as it was sent is equal if the bytes are, unless it is bad.
local function bad_crc_of(message)
  return message.status == "bad" and message.transfer.crc
end

-- Entries are used again for later messages: most sources need one.
local function fill(entry, message)
  entry.key, entry.time, entry.seq = message.key, message.time, message.seq
  entry.payload, entry.bad_crc = message.payload, bad_crc_of(message)
end

-- Keep a message that is no copy, in the entry of one that is too old.
local function keep(list, message, distance)
  for _, entry in ipairs(list) do
    if abs(message.time - entry.time) >= distance then return fill(entry, message) end
  end
  local entry = #list < MAX_KEPT and {} or table.remove(list, 1)
  fill(entry, message)
  list[#list + 1] = entry
end

-- Return when the latest of some messages came.
local function latest_of(list)
  local latest = list.start
  for _, entry in ipairs(list) do latest = max(latest, entry.time) end
  return latest
end

-- Whether the stamps of a source mean nothing: it has had one stamp, as some programs give all that
-- they send, while another source advanced.  It is asked at each copy with that stamp.
local function stands_still(self, list)
  local before, now = list.others, {}
  for source, other in pairs(self.by_source) do
    now[source] = latest_of(other)
    if before and now[source] - (before[source] or other.start) >= MAX_DISTANCE then return true end
  end
  list.others = before or now
  return false
end

-- Return the frame key of an equal message that is near, nil for none.
local function find_in(self, list, message, distance)
  local bad_crc = bad_crc_of(message)
  for _, entry in ipairs(list) do
    local is_equal = entry.payload == message.payload and entry.seq == message.seq
    if is_equal and entry.bad_crc == bad_crc and abs(message.time - entry.time) < distance then
      return not (message.time == list.start and stands_still(self, list)) and entry.key or nil
    end
  end
end

--- Whether time stamps tell what is a copy.
-- time  of a message or packet, seconds since the first packet
function Copies:can_judge(time)
  return self.is_timed and (self.stamps_differ or time ~= 0)
end

--- Find the original of a message, in the order of the capture.
-- message       of reading.messages; on a revisit, return what was found before
-- is_only_pass  whether it is never asked for again
-- returns       frame key of the message that it is a copy of; nil if it is none
function Copies:find(message, is_only_pass)
  if message.visited then return self.originals[message.key] end
  if not self.is_timed then return nil end
  local source, time = message.source, message.time
  local of_type = source.message
  local distance = of_type and of_type.every or 1
  distance = min(MAX_DISTANCE, distance / 2) - HALF_NANOSECOND
  local list = self.by_source[source]
  if not list then
    list = { start = time, others = nil }
    self.by_source[source] = list
  end
  local original = self:can_judge(time) and find_in(self, list, message, distance) or nil
  -- A read filter may have dropped a copy whose number this packet has.
  if not is_only_pass and original ~= self.originals[message.key] then
    self.originals[message.key] = original
  end
  if not original then keep(list, message, distance) end
  return original
end

return M
]=])
module("yapp.reading.messages", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- From a transfer to the message that it carries: its values, and the changes since the source's
-- previous message.  Pure Lua.

local compiler = require "yapp.message.catalogue"

local M = {}

-- A transfer that lacks bytes, or has too many, at an unknown offset.
local IS_BROKEN = { incomplete = true, overrun = true }

local Messages = {}
Messages.__index = Messages

--- Make the reader of the messages of one capture.
-- types    a message.types
-- history  a message.history
-- copies   a reading.copies
function M.new(types, history, copies)
  return setmetatable({
    types = types,
    history = history,
    copies = copies,
    advised = {}, -- [id of an unknown message] = the frame key whose Info has the whole advice
  }, Messages)
end

-- The record of a message.  Nothing adds a field to it, and nothing changes it once it is read.
local function new_message(frame, transfer)
  return {
    transfer = transfer,
    source = frame.source,
    seq = frame.seq,
    key = frame.key,
    number = frame.number, -- of its packet
    time = frame.time, -- seconds since the first packet
    visited = frame.visited,
    status = transfer.status,
    size = transfer.size, -- as its header has it
    payload = transfer.payload, -- the bytes of it that came
    raws = false, -- the values by index of field (message.decode); false if the size does not fit
    remarks = false, -- the remarkable values (message.decode), false for none
    has_fault = false, -- whether a fault flag is set
    undecoded = false, -- number of payload bytes behind the type's size, false for none
    like = false, -- of an unknown message: the type that has its size, false for none
    copy_of = false, -- frame key of the message that it is a copy of, or false
    is_advised = false, -- whether Info says in full which preference decodes it
    is_usual = false, -- whether it is good and decoded, and nothing else is to be said of it
    -- Of message.history:
    change = false, -- the change, or false
    delta = false, -- seconds since the source's previous good message, or false
    state = false, -- the state at the message, or false if it is not known or not wanted
    -- Whether nothing is known of what came before: nothing tells its bus, or controllers share its
    -- source.
    is_unreliable = not (frame.visited or frame.is_bus_known),
  }
end

-- Decode the values.  The payload has min_size bytes of its type at least.  Only a good message may
-- have more than the type's size.
local function decode_values(message, of_type)
  local size, is_good = message.size, message.status == "good"
  local is_longer = size > of_type.size
  if size < of_type.min_size or is_longer and not is_good then return end
  local raws, remarks = of_type.read(message.payload)
  message.raws, message.remarks = raws, remarks
  message.has_fault = remarks and remarks.has_fault or false
  if is_longer then message.undecoded = size - of_type.size end
end

-- Find the type that an unknown message could be of by its size.
local function find_like(self, message)
  local same = message.status == "good" and compiler.of_size(self.types.messages, message.size)[1]
  if not same then return end
  local advised, id = self.advised, message.source.id
  advised[id] = advised[id] or message.key
  message.like, message.is_advised = same, advised[id] == message.key
end

-- Set the history's values of a message.
local function add_history(self, message, frame)
  local change, delta
  if message.visited then
    change, delta = self.history:change(message)
  else
    change, delta = self.history:add(message, frame.is_only_pass)
  end
  message.change, message.delta = change or false, delta or false
  if delta == nil or change and change.unreliable then message.is_unreliable = true end
  message.state = frame.wants_state and self.history:state(message) or false
  -- In a stream, the ID of a damaged frame may be damaged, too.
  if message.source.line and message.status ~= "good" then message.delta = false end
end

local function is_usual(message)
  if message.status ~= "good" or not message.raws then return false end
  return not (message.remarks or message.undecoded or message.copy_of or message.change)
end

--- Read the message of a transfer.
-- frame     that ends it, see reading.records
-- transfer  { status, size, payload }; status = "good" if it is proved complete; "bad" (CRC);
--           "truncated" by the capture; "incomplete"; "overrun"
-- returns   see new_message
function Messages:read(frame, transfer)
  local message, of_type = new_message(frame, transfer), frame.source.message
  if not of_type then
    find_like(self, message)
  elseif not IS_BROKEN[message.status] then
    decode_values(message, of_type)
  end
  if message.status == "good" or message.status == "bad" then
    message.copy_of = self.copies:find(message, frame.is_only_pass) or false
  end
  if not (message.is_unreliable or message.copy_of) then add_history(self, message, frame) end
  message.is_usual = is_usual(message)
  return message
end

return M
]=])
module("yapp.reading.reading", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The reading of a capture: takes each frame and packet once, in the order of the capture, and says
-- what it turned out to be.  Pure Lua.
--
--   frame ──► can.reassembly ─┐
--                             ├─► transfer ─► reading.messages ─► result ─► listener
--   packet ─► serial.streams ─┘              (values, history)
--
-- On a revisit, recall_frame and recall_packet return what they found then.

local can_id = require "yapp.wire.can_id"
local copies = require "yapp.reading.copies"
local decode = require "yapp.message.decode"
local frame = require "yapp.wire.frame"
local framer = require "yapp.serial.framer"
local number_of = require "yapp.base.frame_key".number
local history = require "yapp.message.history"
local lines = require "yapp.serial.lines"
local memo = require "yapp.base.memo"
local messages = require "yapp.reading.messages"
local reassembly = require "yapp.can.reassembly"
local records = require "yapp.reading.records"
local streams = require "yapp.serial.streams"
local transfers = require "yapp.serial.transfers"

local M = {}

local BUS, START = can_id.BUS, can_id.START
local sub = string.sub
local MAX_SHORT = 128 -- bytes; a longer packet of an unknown conversation is YAPP if it is alone

local Reading = {}
Reading.__index = Reading

--- Make the reading.
-- types  a message.types
-- buses  a host.buses: what the capture file says
function M.new(types, buses)
  return setmetatable({
    types = types,
    buses = buses,
    listener = false, -- while a statistic runs, see Reading:listen
  }, Reading)
end

--- Report results from now on, but for plain fragments, which no statistic counts.
-- listener  gets each, as listener:report(result); false for no listener
function Reading:listen(listener)
  self.listener = listener
end

--- Forget the capture file.
-- options  of message.history
function Reading:reset(options)
  local finder = copies.new(self.buses)
  self.messages = messages.new(self.types, history.new(options), finder)
  -- CAN:
  self.reassembly = reassembly.new(nil, function(time) return finder:can_judge(time) end)
  self.sources = memo(function(bus) -- [bus or false][ID] = a source
    return memo(function(id) return self.types:new_source(id, bus, self.buses:name(bus)) end)
  end)
  self.newest_key = 0 -- of the newest frame: one above it is new
  self.accepted_key = 0 -- of the latest frame that is YAPP's
  self.saw_unknown_bus = false -- whether a frame came whose bus is not known
  -- The result of the current frame, which is used again as the frame is.
  self.result = records.new_result("other", false)
  -- Streams:
  self.streams = streams.new(function() return self:new_framer() end,
    function(time) return finder:can_judge(time) end)
  self.lines = lines.new(self.types, self.buses)
  self.found = {} -- [trial_key of a line] = true: conversations that were found by content
end

-- Report a result, and return it.
local function report(self, result)
  local listener = self.listener
  if listener then listener:report(result) end
  return result
end

-- CAN ---------------------------------------------------------------------------------------------

-- Return the message that a frame ends, false for none.
local function message_of(self, of_frame, kind, transfer)
  if kind ~= "last" and kind ~= "single" then return false end
  local message = self.messages:read(of_frame, transfer)
  local is_kept = kind == "single" or of_frame.visited or of_frame.is_only_pass
  if not is_kept then self.reassembly:keep(transfer, message.has_fault) end
  return message
end

-- Return the result of a frame.
-- kind ...  of can.reassembly
local function new_frame_result(self, of_frame, kind, transfer, anomalies, index)
  local result, message = self.result, message_of(self, of_frame, kind, transfer)
  self.accepted_key = of_frame.key
  result.kind = kind
  result.frame = of_frame
  result.transfer = transfer or false
  result.message = message
  result.anomalies = anomalies or false
  result.index = index or false
  local is_plain = not anomalies and #of_frame.data == of_frame.reported
  result.is_usual = is_plain and (not message or message.is_usual)
  if message or anomalies then report(self, result) end
  return result
end

--- Add the next frame of the capture.
-- of_frame  see reading.records
-- returns   its result; nil for a frame that is not YAPP's
function Reading:add_frame(of_frame)
  local fields, bus, key = of_frame.can_id, of_frame.bus, of_frame.key
  of_frame.source = self.sources[bus][fields.id]
  of_frame.slot = fields.message_key + (bus or 0) * BUS
  if not of_frame.is_bus_known then self.saw_unknown_bus = true end
  if key > self.newest_key then
    self.newest_key = key
  else -- a read filter (-R) dropped the packet before, and this one has its number
    self.reassembly:forget(key)
  end
  local kind, transfer, anomalies = self.reassembly:add(of_frame)
  return kind and new_frame_result(self, of_frame, kind, transfer, anomalies)
end

--- Return the result of Reading:add_frame.
function Reading:recall_frame(of_frame)
  local fields, bus = of_frame.can_id, of_frame.bus
  of_frame.source = self.sources[bus][fields.id]
  of_frame.slot = fields.message_key + (bus or 0) * BUS
  local kind, transfer, anomalies, index = self.reassembly:recall(of_frame)
  if transfer then of_frame.source = transfer.source end
  return kind and new_frame_result(self, of_frame, kind, transfer, anomalies, index)
end

-- Return what a frame may be by its data, as { [CAN CTRL] = payload size of the message }: a Start,
-- or a message of the catalogue that fits into a single frame.
local function possible_sizes(self, data)
  local sizes, _, size, reserved = {}, can_id.start(data)
  if #data == 8 and reserved == 0 and size > 8 then sizes[START] = size end
  for _, message in ipairs(self.types.messages) do
    size = can_id.single_size(data, #data, message.min_size, message.size)
    if size and decode.is_plausible(message, sub(data, 1, size)) then sizes[0] = size end
  end
  return sizes
end

-- Return the payload size that a frame has as a message that is not dissected; nil for none.
local function undissected_size(self, fields, source, data)
  local message, size = source.message, possible_sizes(self, data)[fields.ctrl]
  if fields.ctl ~= 0 then return message and size or nil end
  local is_longer = fields.ctrl == 0 and message and #data > message.size
  if is_longer and decode.is_plausible(message, sub(data, 1, message.size)) then return #data end
  return size
end

--- Report a frame that is not dissected, if it may be a message or begin one:
--   of an unknown ID
--   of a known ID, with a YAPP CTL other than 0
--   of a known ID, with bytes behind its values
-- of_frame  see reading.records
function Reading:report_undissected(of_frame)
  local fields = of_frame.can_id
  local source = self.sources[of_frame.bus][fields.id]
  local size = undissected_size(self, fields, source, of_frame.data)
  if not size then return end
  of_frame.source = source
  local result = records.new_result("undissected", of_frame)
  result.length = size
  report(self, result)
end

-- Streams -----------------------------------------------------------------------------------------

--- Make a framer for bytes of a capture.
-- patience  of serial.framer; nil for the usual
function Reading:new_framer(patience)
  return framer.new(function(id) return self.types:size_of(id) end, patience)
end

--- Return whether bytes are YAPP: they hold a good frame, or a message of the catalogue with a bad
-- CRC or bytes missing.  Ten bytes of its header are given, so chance does not make one.
function Reading:is_yapp(bytes)
  if not frame.find(bytes, 1) then return false end
  for _, finding in ipairs(self.streams:read(bytes)) do
    local id = finding.status ~= "skipped" and frame.parse(bytes, finding.offset + 1)
    if finding.status == "good" or id and self.types:size_of(id) then return true end
  end
  return false
end

--- Return whether bytes of an unknown conversation may be YAPP, alone or with those behind them.
function Reading:may_be_yapp(bytes)
  return self:is_yapp(bytes) or #bytes <= MAX_SHORT and self.streams.may_begin(bytes)
end

-- Return the result of a finding, with the message that it holds.
-- index  of the finding in its packet
local function finding_result(self, packet, finding, index)
  if finding.status == "skipped" then
    local of_bytes = records.new_serial_frame(packet, 1, packet.line)
    local result = records.new_result("skipped", of_bytes)
    result.transfer, result.length = finding, finding.to - finding.from
    return result
  end
  local transfer, id, seq, anomalies = transfers.new(finding, finding.bytes or packet.bytes)
  local source = self.lines:source(packet.line, id)
  if packet.line.awaited then lines.note_read(packet.line, transfer) end
  local of_frame = records.new_serial_frame(packet, index, source, seq)
  local result = records.new_result("single", of_frame)
  result.transfer, result.anomalies = transfer, anomalies
  result.message = self.messages:read(of_frame, transfer)
  return result
end

-- Return what a packet turned out to be: its contents, as serial.streams has them, with the results
-- of its findings.
local function new_packet_result(self, packet, contents)
  local results = {}
  for i, finding in ipairs(contents.findings) do
    results[i] = report(self, finding_result(self, packet, finding, i))
  end
  return {
    results = results,
    pending = contents.pending,
    is_held = contents.is_held,
    missing = contents.missing,
    leads_to = contents.leads_to,
    is_unfinished = packet.visited and self.streams:is_unfinished(contents, packet),
  }
end

--- Add the next packet of the capture.
-- packet   see host.serial
-- returns  { results = list of a result for each frame, and for each stretch of bytes of no frame;
--          pending, is_held, missing, leads_to = see serial.streams; is_unfinished = on a revisit:
--          whether the capture ends before the frame that the pending bytes begin }; false for a
--          datagram of others in a conversation that was found by content
function Reading:add_packet(packet)
  local contents = self.streams:add(packet, not packet.is_only_pass)
  return not contents.is_others and new_packet_result(self, packet, contents)
end

--- Return whether a packet of an unknown conversation is YAPP, alone or with those before it, which
-- are added then.
-- packet   see host.serial
-- returns  that, and whether some came before it
function Reading:try_packet(packet)
  local line = packet.line
  if self.found[line.trial_key] then return false end -- add_packet has left it to others
  local earlier = self.streams:try(packet, self:is_yapp(packet.bytes))
  if not earlier then return false end
  self.found[line.trial_key] = true
  for _, one in ipairs(earlier) do self:add_packet(one) end
  local others = line.is_ip and self.streams:end_trial(line.opposite) or {}
  for _, one in ipairs(others) do
    one.is_found = true
    self:add_packet(one)
  end
  return true, earlier[1] ~= nil
end

--- Return the result of Reading:add_packet; nil for a packet that was not added.
function Reading:recall_packet(packet)
  local contents = self.streams:find(packet)
  return contents and new_packet_result(self, packet, contents)
end

--- Add a packet of a raw dump whose bytes are of no frame.
-- returns  as of Reading:add_packet
function Reading:add_skipped(packet)
  local finding = { status = "skipped", from = 0, to = #packet.bytes, offset = 0 }
  return new_packet_result(self, packet, { findings = { finding }, pending = 0 })
end

-- The end -----------------------------------------------------------------------------------------

-- The CAN messages that the capture ends before.
local function finish_frames(self, list)
  for _, transfer in ipairs(self.reassembly:unfinished()) do
    local key, source = transfer[#transfer], transfer.source
    -- Where buses are not known any more, a message of a known bus may have gone on unseen.  A
    -- fraction marks a frame that a read filter dropped.
    if key % 1 == 0 and not (self.saw_unknown_bus and source.bus_key) then
      local of_frame = records.new_can_frame()
      of_frame.key, of_frame.number, of_frame.time = key, number_of(key), transfer.time
      of_frame.source, of_frame.seq = source, transfer.slot % 0x100
      list[#list + 1] = records.new_result("unfinished", of_frame)
    end
  end
end

-- Return the result of a finding in bytes that wait when the capture ends; nil for bytes that may
-- be a part of a frame.
local function waiting_result(self, packet, finding, index, may_go_on)
  local is_skipped = finding.status == "skipped"
  if is_skipped and finding.to - finding.from < frame.HEADER then return nil end
  if is_skipped or not (finding.missing or may_go_on) then
    -- The key of no other message: packets have fewer findings than bytes.
    return finding_result(self, packet, finding, is_skipped and 1 or packet.length + index)
  end
  local id, _, _, seq = frame.parse(finding.bytes, finding.offset + 1)
  local of_frame = records.new_serial_frame(packet, 1, self.lines:source(packet.line, id), seq)
  return records.new_result("unfinished", of_frame)
end

--- Return the results of what waits when all packets have come: messages that the capture ends
-- before, and others behind a frame that seems to be open, or behind a gap in a TCP connection.
-- may_go_on  whether more packets may come, as in Wireshark: there every message that waits is one
--            that the capture ends before
function Reading:finish(may_go_on)
  local list = {}
  finish_frames(self, list)
  for _, open in ipairs(self.streams:unfinished()) do
    for i, finding in ipairs(open.findings) do
      list[#list + 1] = waiting_result(self, open.packet, finding, i, may_go_on)
    end
  end
  return list
end

--- Return the gaps in TCP connections, in the form of Buses:drops.
function Reading:drops()
  return self.streams:drops()
end

return M
]=])
module("yapp.reading.records", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The records that go into the reading of a capture and come out of it.  Pure Lua.  Each has one
-- constructor, which names every field.  host.serial has that of a packet, reading.messages that of
-- a message, can.reassembly and serial.transfers those of transfers.

local M = {}

--- Make the record of a CAN frame.  It is used again for the next frame, which saves a tenth of a
-- packet list: keep no reference to it.
function M.new_can_frame()
  return {
    -- host.can fills in:
    key = 0, -- see base.frame_key
    number = 0, -- of its packet
    time = 0, -- seconds since the first packet
    visited = false, -- whether it is a revisit
    can_id = false, -- the fields of its CAN id (wire.can_id)
    seq = 0, -- of can_id
    data = "", -- the captured bytes
    reported = 0, -- number of bytes on the bus
    bus = false, -- its number, or false
    is_bus_known = true, -- whether the capture tells where it was captured
    accepts_all = false, -- whether the user says that every extended frame is YAPP
    is_only_pass = false, -- whether it is never dissected again
    wants_state = false, -- whether the state of its message is wanted
    -- The reading fills in:
    source = false, -- see message.types
    slot = 0, -- see can_id.slot
  }
end

--- Make the record of a frame in a packet.  The n-th finding of a packet has the frame key of the
-- packet + n - 1.  As a frame has at least 16 bytes, no other packet has that key, not even in a
-- tunnel that puts several packets into one.
function M.new_serial_frame(packet, index, source, seq)
  return {
    key = packet.key + index - 1,
    number = packet.number,
    time = packet.time,
    visited = packet.visited,
    seq = seq,
    is_bus_known = packet.is_bus_known,
    is_only_pass = packet.is_only_pass,
    wants_state = packet.wants_state,
    source = source, -- the line, of skipped bytes
  }
end

--- Make the record of what a frame, or a part of a packet, turned out to be.
-- kind     "single", a message in one frame; "last", which ends a message of several; "fragment";
--          "other", which has no message; "skipped", bytes of no frame; "unfinished", what the
--          capture ends before; "undissected", which may be a message that is not decoded
-- frame    see above
-- returns  all that the view and the statistics see
function M.new_result(kind, frame)
  return {
    kind = kind,
    frame = frame,
    transfer = false, -- that the frame belongs to, or false
    message = false, -- that it ends, or false
    anomalies = false, -- list of { expert, text, ... }, see can.reassembly; or false
    index = false, -- of the frame in its transfer, on a revisit; or false
    length = 0, -- number of bytes: of skipped ones; size of an undissected message
    is_usual = false, -- whether it needs no expert item; known of CAN frames
  }
end

return M
]=])
module("yapp.serial.framer", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- Framing: finds YAPP frames in bytes that also hold noise, shell text and damaged frames.
-- Pure Lua.
--
-- Each "YP" with a header behind it is a candidate.  Candidates are judged in the order of their
-- starts: the first one with a good CRC is a frame, and all that overlap it are dropped.  So a
-- frame wins over what its payload contains.  Bytes behind the start of an open candidate, whose
-- end has not come, wait for it:
--
--   0         12                              69      bytes 12 to 60 hold a good frame; it is shown
--   |YP header|  ...  |YP good frame|   ...   |       only if the CRC at 69 is bad
--
-- But a header of noise may claim 65,535 bytes.  So good frames do not wait for an open candidate
-- of more than `patience` bytes, or of `noise_patience` if its header is not plausible: that of
-- "TYPE = 12".  If a good frame comes first, that candidate is dropped.
--
-- The header decides what a candidate without a good CRC is.  A message of the catalogue is that
-- message, damaged, up to where the next one begins.  Another plausible ID is a bad frame if all
-- its bytes came and no message of the catalogue begins in them.  Everything else is noise.
--
-- A serial server in telnet mode (RFC 854) sends each byte 0xFF twice.  If that makes a CRC good,
-- the stream is telnet from there on:
--
--   59 50 00 00 .. FF FF 12 .. CRC   49 bytes in the stream, a frame of 48

local crc = require "yapp.wire.crc"
local frame = require "yapp.wire.frame"

local M = {}

local byte, find, sub = string.byte, string.find, string.sub

local HEADER, CRC_SIZE = frame.HEADER, frame.CRC_SIZE
local Y = byte(frame.SYNC)
local TWICE = "\255\255" -- a byte 0xFF in telnet

-- The longest open candidates that good frames inside them wait for: 7 s of a controller's
-- messages, or two messages.
local PATIENCE, NOISE_PATIENCE = 4096, 128

-- Noise may be full of candidates.  So each byte of a stream earns credit for CREDIT bytes of CRC,
-- saved up to MAX_CREDIT.  A candidate that costs more than the credit counts as damaged.
-- Candidates of 32 to 63 bytes have one credit, those of 64 to 127 bytes another, and so on: large
-- ones cannot spend the credit of small ones.
local CREDIT = 2
local MAX_CREDIT = 4 * frame.LARGEST

local Framer = {}
Framer.__index = Framer

--- Make the framer of a stream.
-- size_of   function(id) -> payload size of the catalogue's message, nil for an unknown ID; and its
--           smallest size, nil if that is the same
-- patience  bytes: the longest open candidate, plausible or not, that good frames inside it wait
--           for; nil for the usual ones
-- Document: "UART Stream Framing".
function M.new(size_of, patience)
  local self = setmetatable({
    size_of = size_of,
    patience = patience or PATIENCE,
    noise_patience = patience or NOISE_PATIENCE,
    telnet = false, -- "may" be telnet, see Framer:expect_telnet, or "is"
    spent = {},    -- [logarithm of a candidate's length] = bytes that CRCs were computed over
    text = "",     -- the latest bytes
    text_from = 0, -- their offset in the stream
    to = 0,        -- the end of the stream so far; serial.streams also reads `to` and `from`
    from = 0,      -- the first byte that is in no finding yet
    searched = 0,  -- every candidate that begins before this is known
    is_ending = false, -- whether no more bytes come
    found = false, -- the open candidate that the search waited at last
  }, Framer)
  self:forget()
  return self
end

-- Drop all candidates.
function Framer:forget()
  self.candidates = {} -- those that failed and those that are open, by start
  self.first, self.last = 1, 0
  self.first_open = 1  -- in `candidates`: all before it have failed
  self.open_by_end = {} -- [offset] = the last open one that ends there
  self.known = {}       -- the starts of those that are messages of the catalogue
end

--- Expect that each byte 0xFF may come twice.
function Framer:expect_telnet()
  self.telnet = self.telnet or "may"
end

-- Return bytes of telnet as they were before it.
-- index, count  of the first one in the text; how many are wanted
-- returns  them, and how many bytes of the text they are; or nil, and how many are to come
local function undouble(text, index, count)
  local parts, start = {}, index
  while count > 0 do
    local twice = find(text, TWICE, index, true)
    local part = sub(text, index, math.min(twice or #text, index + count - 1))
    parts[#parts + 1], count, index = part, count - #part, index + #part
    local is_half = count == 0 and index > #text and byte(text, -1) == 255
    if is_half or count > 0 and not twice then return nil, math.max(count, 1) end
    if twice == index - 1 then index = index + 1 end
  end
  return table.concat(parts), index - start
end

-- Whether a header is that of a message that there may be; its ID and size; whether it is known.
local function read_header(self, text, index)
  local id, size, reserved = frame.parse(text, index)
  if not id then return false end
  local known, smallest = self.size_of(id)
  local fits = not known or size <= known and size >= (smallest or known)
  return reserved == 0 and id <= frame.MAX_ID and fits, size, known ~= nil
end

-- Return the candidate of a "YP", nil if its header has not come.
-- index  in the text, 1-based
local function candidate_at(self, index)
  local is_plausible, size, is_known = read_header(self, self.text, index)
  local twice = self.telnet and find(self.text, TWICE, index, true)
  if twice and twice < index + HEADER and (self.telnet == "is" or not is_plausible) then
    local header = undouble(self.text, index, HEADER)
    if not (header or self.is_ending) then return nil end
    local is_better, its_size, its_known = read_header(self, header or "", 1)
    if is_better or self.telnet == "is" then
      is_plausible, size, is_known = is_better, its_size, its_known
    end
  end
  if not size then return nil end
  local from, length = self.text_from + index - 1, HEADER + size + CRC_SIZE
  return {
    from = from,
    to = from + length,
    length = length, -- before telnet
    bytes = nil,     -- of a frame in telnet: those before it
    is_plausible = is_plausible,
    is_known = is_plausible and is_known,
    has_failed = false, -- whether its CRC is bad; false while it is open
  }
end

-- Return the next candidate whose header has come, nil where none has.
function Framer:find()
  if self.found and self.found.from == self.searched then return self.found end
  local index = frame.find(self.text, self.searched - self.text_from + 1)
  if not index then
    local is_begun = self.to > self.searched and byte(self.text, -1) == Y
    self.searched = is_begun and self.to - 1 or self.to
    return nil
  end
  self.searched = self.text_from + index - 1
  return candidate_at(self, index)
end

-- Whether the CRC of a frame is good.
-- text, index  its bytes, from there on; length = of it
function Framer:is_good(text, index, length)
  local class, earned = math.floor(math.log(length, 2)), MAX_CREDIT + CREDIT * self.to
  local spent = math.max(self.spent[class] or 0, earned - MAX_CREDIT) + length
  if spent > earned then return false end
  self.spent[class] = spent
  local to = index + length - 1
  return crc.update(crc.INITIAL, text, index, to - CRC_SIZE) == frame.crc(text, to)
end

-- Whether a candidate is a frame of telnet.  If more bytes have to come, its end moves.
function Framer:is_telnet(candidate, index)
  local bytes, count = undouble(self.text, index, candidate.length)
  local is_sure = self.telnet == "is"
  if bytes and self:is_good(bytes, 1, candidate.length) then
    candidate.to, candidate.bytes, self.telnet = candidate.from + count, bytes, "is"
    return true
  end
  if bytes and is_sure then
    candidate.to = candidate.from + count
  elseif not bytes and not self.is_ending then
    candidate.to = self.to + count
  end
  return false
end

-- Whether a candidate whose end has come is a frame; the end of one of telnet may move.
function Framer:judge(candidate)
  local index, is_sure = candidate.from - self.text_from + 1, self.telnet == "is"
  if not self.telnet then return self:is_good(self.text, index, candidate.length) end
  local last = index + candidate.length - 1
  local twice = find(self.text, TWICE, index, true)
  local may_be_telnet = twice and twice <= last or is_sure and byte(self.text, last) == 255
  if not (may_be_telnet and is_sure) then
    candidate.to = candidate.from + candidate.length
    if self:is_good(self.text, index, candidate.length) then return true end
  end
  return may_be_telnet and self:is_telnet(candidate, index)
end

-- Expect no more bytes of telnet, as the stream ends.
function Framer:end_telnet()
  for i = self.first, self.last + 1 do
    local candidate = self.candidates[i] or self.found
    if candidate then candidate.to = candidate.from + candidate.length end
  end
end

-- Append the bytes up to an offset as a finding.
-- bytes  nil for those in the text
function Framer:give(to, status, missing, bytes)
  local from, offset = self.from, self.from - self.text_from
  self.from = to
  table.insert(self.findings, {
    status = status,
    missing = missing,
    from = from,
    to = to,
    is_telnet = bytes and true,
    bytes = bytes or sub(self.text, offset + 1, offset + to - from),
  })
end

-- Skip the bytes up to an offset.  They go to the latest finding if it is of skipped bytes, too.
function Framer:skip(to)
  if to <= self.from then return end
  local latest = self.findings[#self.findings]
  if not (latest and latest.status == "skipped") then return self:give(to, "skipped") end
  latest.bytes = latest.bytes .. sub(self.text, self.from - self.text_from + 1, to - self.text_from)
  latest.to, self.from = to, to
end

-- Return what a candidate without a good CRC is, if nothing before `limit` is open.
-- behind   what begins at the limit: "open", "good" (a frame) or "end" (nothing)
-- returns  "bad" or "incomplete" and its end; nil for noise; "open" if that is not decided yet
local function class_of(self, candidate, limit, behind)
  if candidate.from < self.from or not candidate.is_plausible then return nil end
  local stop = math.min(limit, self.known[candidate.next_known] or limit)
  if candidate.to <= stop then return "bad", candidate.to end
  if stop == limit and behind == "open" then return "open" end
  if candidate.is_known or stop == limit and behind == "end" then return "incomplete", stop end
end

-- Append what lies before `limit` as findings: the damaged frames, the earliest start first, and
-- the bytes between them.
function Framer:settle(limit, behind)
  while self.first <= self.last and self.candidates[self.first].from < limit do
    local candidate = self.candidates[self.first]
    local status, stop = class_of(self, candidate, limit, behind)
    if status == "open" then
      limit = candidate.from
      break
    end
    if status then
      self:skip(candidate.from)
      self:give(stop, status, candidate.to > stop and candidate.to - stop or nil)
    end
    self.candidates[self.first] = nil
    self.first = self.first + 1
  end
  self:skip(limit)
end

-- Append a candidate as a finding if its CRC is good; return whether it is good.
function Framer:accept(candidate)
  if not self:judge(candidate) then
    candidate.has_failed = candidate.to <= self.to -- else its end is still to come
    return false
  end
  self:settle(candidate.from, "good")
  self:give(candidate.to, "good", nil, candidate.bytes)
  if self.last > 0 then self:forget() end
  self.searched = candidate.to
  return true
end

-- Judge an open candidate when its end comes.  It gets
--   same_end    another open candidate that ends where this one does, or nil
function Framer:expect_end(candidate)
  candidate.same_end = self.open_by_end[candidate.to]
  self.open_by_end[candidate.to] = candidate
end

-- Keep a candidate that failed or is open.  It gets
--   next_known  index in `known`: the first one behind it
function Framer:keep(candidate)
  self.last = self.last + 1
  self.candidates[self.last] = candidate
  if candidate.is_known then self.known[#self.known + 1] = candidate.from end
  candidate.next_known = #self.known + 1
  if not candidate.has_failed then self:expect_end(candidate) end
end

local function by_start(a, b) return a.from < b.from end

-- Judge the open candidates whose end has come.
-- before  the end of the stream before these bytes came
function Framer:judge_ended(before)
  if not next(self.open_by_end) then return end
  local due = {}
  for to = before + 1, self.to do
    local candidate = self.open_by_end[to]
    self.open_by_end[to] = nil
    while candidate do
      due[#due + 1], candidate = candidate, candidate.same_end
    end
  end
  table.sort(due, by_start)
  for _, candidate in ipairs(due) do
    if self:accept(candidate) then return end -- it overlaps the others
    if not candidate.has_failed then self:expect_end(candidate) end
  end
end

-- Judge the candidates that begin in bytes that have not been searched.
function Framer:search()
  local candidate = self:find()
  while candidate do
    local patience = candidate.is_plausible and self.patience or self.noise_patience
    local is_frame = candidate.to <= self.to and self:accept(candidate)
    local is_open = candidate.to > self.to
    if is_open and not self.is_ending and candidate.length <= patience then
      self.found = candidate
      return
    end
    if not is_frame then
      self:keep(candidate)
      self.searched = candidate.from + #frame.SYNC
    end
    candidate = self:find()
  end
end

-- Return the first open candidate that is kept, by start, or nil.
function Framer:first_waiting()
  local candidate = self.candidates[self.first_open]
  while candidate and candidate.has_failed do
    self.first_open = self.first_open + 1
    candidate = self.candidates[self.first_open]
  end
  return candidate
end

--- Take the next bytes of the stream.
-- bytes     string of any length
-- is_end    whether the stream ends behind them.  Then all findings become final: a frame whose end
--           has not come is "incomplete", too.  Later bytes begin a new stream
-- findings  list that the new findings are appended to; nil for a new one
-- returns  the list, with the findings that are final now, in the stream's order; each byte of the
--          stream is in one finding: {
--            status   "good"; "bad" (CRC); "incomplete", a frame that ends where the next begins;
--                     "skipped", bytes of no frame
--            missing  number of bytes, of an incomplete frame
--            from     offset in the stream
--            to       offset behind the last byte
--            is_telnet  true if its bytes are not those of the stream, but as before telnet
--            bytes    string }
-- Document: "UART Stream Framing".
function Framer:add(bytes, is_end, findings)
  local before = self.to
  self.findings, self.is_ending = findings or {}, is_end
  if self.from > self.text_from then
    self.text, self.text_from = sub(self.text, self.from - self.text_from + 1), self.from
  end
  self.text, self.to = self.text .. bytes, before + #bytes
  if is_end and self.telnet == "may" then self:end_telnet() end
  self:judge_ended(before)
  self:search()
  if is_end then
    self:settle(self.to, "end")
    if self.last > 0 then self:forget() end
    self.searched = self.to
  else
    local waiting = self:first_waiting()
    self:settle(waiting and waiting.from or self.searched, "open")
    if self.last > 0 and self.first > self.last then self:forget() end
  end
  return self.findings
end

--- Return whether bytes in no finding yet begin with the header of a message of the catalogue.
function Framer:has_known()
  for i = self.first, self.last + 1 do
    local candidate = self.candidates[i] or self:find()
    if candidate and candidate.is_known and candidate.from >= self.from then return true end
  end
  return false
end

--- Return the bytes that are in no finding yet.
function Framer:pending()
  return sub(self.text, self.from - self.text_from + 1)
end

--- Return whether a frame is not final yet: a capture that ends here ends before it.  A part of a
-- header is none, nor is what is more likely noise.
-- returns  boolean, and the number of bytes to come, nil if all came
function Framer:open_frame()
  for i = self.first, self.last + 1 do
    local candidate = self.candidates[i] or self:find()
    if candidate and candidate.is_plausible and candidate.from >= self.from then
      local missing = candidate.to - self.to
      return true, missing > 0 and missing or nil
    end
  end
  return false
end

return M
]=])
module("yapp.serial.lines", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The lines of a capture: a line is one direction of a conversation, of a UART or of a USB adapter.
-- And their sources: who receives a sender's messages does not matter.  Pure Lua.

local memo = require "yapp.base.memo"
local senders = require "yapp.serial.senders"

local M = {}

M.TCP, M.UDP = 2, 3 -- pinfo.port_type
local MAX_SILENCE = 3 -- seconds, of a connection that goes on
-- Addresses of packets without one: of a serial line, or of a raw dump, whose packets are like UDP.
local NO_ADDRESS = { [""] = true, NONE = true }

local Lines = {}
Lines.__index = Lines

--- Make the lines of a capture.
-- types  a message.types, buses = a host.buses
function M.new(types, buses)
  return setmetatable({
    types = types,
    buses = buses,
    senders = senders.new(),
    by_address = memo(function() -- [from][to][tag, with the bus] = a line
      return memo(function() return {} end)
    end),
    by_key = {},
    clients = {}, -- [sender's address, receiver] = the latest line of TCP
    awaited = {}, -- by key of a line: the payload of the first frame that the file has of it
    has_serial = false, -- whether a line is neither of UDP or TCP nor of an adapter
    sources = memo(function() return {} end), -- [sender in UDP or TCP][ID]
  }, Lines)
end

--- Whether packets of a kind (pinfo.port_type) from an address are of UDP or TCP.
function M.is_ip(kind, address)
  return (kind == M.UDP or kind == M.TCP) and not NO_ADDRESS[address]
end

-- Make a line: {
--   key          of its stream
--   opposite     key of the other direction
--   bus_key      what a Command and its answers have in common: one key for both directions of a
--                conversation or adapter, one for all of a UART
--   trial_key    what is found by content: a conversation, one direction of an adapter
--   tag          what few lines share: the kind and ports of packets; the key of an adapter's
--   bus          name or nil
--   label        text that tells its sources apart, nil if nothing does
--   has_address  whether its packets have a sender
--   interface    of UDP or TCP: the name of its interface, or nil
--   is_tcp, is_datagram  whether it is of TCP, of UDP
--   is_complete  whether each of its packets is complete in itself: of a raw dump
--   latest       when its latest packet came, in seconds
--   is_over      whether a segment of it ends the connection
--   is_direct    whether TCP hands its bytes to YAPP; false where TLS does
--   awaited      the payload of the first frame that the file has of it; nil once it was read, or
--                if it is not known
--   sources      [ID] = a source, see Lines:source; all lines of a sender share them }
local function new_line(key, opposite, bus_key, bus)
  return {
    key = key,
    opposite = opposite,
    bus_key = bus_key,
    trial_key = key,
    tag = key,
    bus = bus,
    label = bus,
    has_address = false,
    interface = nil,
    is_ip = false,
    is_tcp = false,
    is_datagram = false,
    is_complete = false,
    latest = 0,
    is_over = false,
    is_direct = false,
    awaited = nil,
    sources = {},
  }
end

-- Return the sender's line to a receiver in the connection before, nil for none.  A client that
-- connects again has a new port, and is the same source.  But two connections may go on side by
-- side, of two clients behind one address.
-- time  seconds, when the new connection begins; nil if it is not known
local function line_before(self, address, to, time)
  local before = self.clients[address .. " " .. to]
  local is_over = before and (before.is_over or time and time - before.latest > MAX_SILENCE)
  return is_over and before or nil
end

-- Make a line of UDP or TCP.
local function new_ip_line(self, kind, key, address, port, to, time)
  local here = address .. ":" .. port
  local opposite = "|" .. kind .. "|" .. to .. "|" .. here
  local is_udp = kind == M.UDP
  local bus = is_udp and self.senders:name_of(address, port) or senders.name(address, port)
  local before = not is_udp and line_before(self, address, to, time)
  if before then bus = before.bus end
  local line = new_line(key, opposite, here < to and here .. to or to .. here, bus)
  line.trial_key = kind .. line.bus_key -- UDP and TCP may have the same ports
  line.has_address, line.is_ip = true, true
  line.is_tcp, line.is_datagram = not is_udp, is_udp
  line.interface = self.buses:name(nil, true)
  line.sources = self.sources[kind .. bus]
  if not is_udp then self.clients[address .. " " .. to] = line end
  return line
end

--- Return a number for each kind and each pair of ports.
-- kind  pinfo.port_type
function M.tag(kind, port, to_port)
  return (kind * 0x10000 + port) * 0x10000 + to_port
end

local function new_serial_line(self, bus, key, opposite, is_complete)
  local line = new_line(key, opposite, "serial", self.buses:name(bus, false))
  line.label, line.is_complete = bus and line.bus, is_complete
  self.has_serial = true
  return line
end

--- Return the line of a packet.
-- kind           pinfo.port_type
-- from, port     address and port of the sender
-- to, to_port    of the receiver
-- bus            number, nil for none
-- time           in seconds, of a packet of UDP or TCP that comes for the first time; or nil
function Lines:of(kind, from, port, to, to_port, bus, time)
  local lines, number = self.by_address[from][to], M.tag(kind, port, to_port)
  if bus then number = number + bus * 2 ^ 36 end
  local line = lines[number]
  if time and kind == M.UDP then self.senders:note(from, port, time) end
  if line then
    line.latest = time or line.latest
    return line
  end
  local here, there = from .. ":" .. port, to .. ":" .. to_port
  local key = (bus or "") .. "|" .. kind .. "|" .. here .. "|" .. there
  if M.is_ip(kind, from) then
    line = new_ip_line(self, kind, key, from, port, there, time)
    line.tag, line.latest, line.awaited = number, time or 0, self.awaited[key]
  else
    local opposite = (bus or "") .. "|" .. kind .. "|" .. there .. "|" .. here
    line = new_serial_line(self, bus, key, opposite, kind == M.UDP)
  end
  lines[number], self.by_key[key] = line, line
  return line
end

-- Return the key of the line of a conversation.
local function key_of(conversation)
  local kind = conversation.is_tcp and M.TCP or M.UDP
  return "|" .. kind .. "|" .. conversation.from .. "|" .. conversation.to
end

--- Await the first frames that the file has of conversations: another protocol may take them.
-- conversations  of serial.senders
function Lines:await(conversations)
  for _, one in ipairs(conversations) do self.awaited[key_of(one)] = one.payload end
end

--- Note that a frame of a line was read.
function M.note_read(line, transfer)
  local is_first = transfer.payload == line.awaited or transfer.status == "truncated"
  if line.awaited and is_first then line.awaited = nil end
end

--- Return those of a list of conversations that no message was read of, or not the first one.
-- conversations  of serial.senders
function Lines:unread(conversations)
  local list = {}
  for _, one in ipairs(conversations) do
    local line = self.by_key[key_of(one)]
    local is_read = line and next(line.sources) and not line.awaited
    if not is_read then list[#list + 1] = one end
  end
  return list
end

--- Return the line of an endpoint of a USB adapter.
-- endpoint  the line of serial.usb
function Lines:of_adapter(endpoint)
  local line = self.by_key[endpoint.name]
  if not line then
    line = new_line(endpoint.name, endpoint.opposite, endpoint.device, endpoint.name)
    line.has_address = true
    self.by_key[endpoint.name] = line
  end
  return line
end

--- Return the source of the messages of a line with an ID, see message.types.
function Lines:source(line, id)
  local source = line.sources[id]
  if not source then
    if line.is_ip then line.label = self.senders:short(line.bus) end
    source = self.types:new_source(id, line.bus_key, line.bus, line)
    line.sources[id] = source
  end
  return source
end

return M
]=])
module("yapp.serial.repeats", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- Finds datagrams of a byte stream that the recorder holds twice, as with `-i any` or a mirror
-- port.  Pure Lua.
--
-- Frames are cut over packets, so copies must not come between the bytes of their originals:
--   packet 1  |start of A|    packet 2  the same    packet 3  |end of A|    packet 4  the same
--
-- Equal bytes are no proof: idle controllers send the same values.  Two packets with the header of
-- one ID within 20 ms are.  From there on, the packet behind the original is expected once more.

local frame = require "yapp.wire.frame"
local memo = require "yapp.base.memo"

local M = {}

local abs = math.abs
local MAX_DISTANCE = 0.02 -- seconds, as of reading.copies
local MAX_KEPT = 1024 -- packets of a stream
local ID_TO = 7 -- bytes of a header behind its first, up to the ID

local Repeats = {}
Repeats.__index = Repeats

local function new_stream()
  return {
    count = 0, -- of originals
    copies = { [0] = 0 }, -- [number of an original, modulo MAX_KEPT] = how many copies came
    -- [bytes] = { number, time } of the latest original; those of the last 20 ms at least
    recent = {},
    older = {},
    since = nil, -- when `recent` began
  }
end

--- Make the finder.
-- can_judge  function(time): whether time stamps tell what is a copy, see reading.copies
function M.new(can_judge)
  return setmetatable({ can_judge = can_judge, by_stream = memo(new_stream) }, Repeats)
end

-- Whether bytes have the header of a frame up to its ID.
local function has_id(bytes)
  local start = frame.find(bytes, 1)
  return start ~= nil and start + ID_TO <= #bytes
end

-- Whether a packet is a copy of an original with its bytes.
local function is_copy(stream, original, packet)
  if abs(packet.time - original.time) >= MAX_DISTANCE then return false end
  local copies, number = stream.copies, original.number
  local is_next = copies[(number - 1) % MAX_KEPT] > copies[number % MAX_KEPT]
  return is_next or has_id(packet.bytes)
end

local function keep(stream, packet)
  if not stream.since or abs(packet.time - stream.since) >= MAX_DISTANCE then
    stream.recent, stream.older, stream.since = {}, stream.recent, packet.time
  end
  stream.count = stream.count + 1
  stream.copies[stream.count % MAX_KEPT] = 0
  stream.recent[packet.bytes] = { number = stream.count, time = packet.time }
end

--- Take the next packet of a stream.
-- packet   see serial.streams, and time = seconds since the first packet
-- returns  0, or n if it is the n-th copy of one before
function Repeats:copy_number(packet)
  if not self.can_judge(packet.time) then return 0 end
  local stream, bytes = self.by_stream[packet.stream], packet.bytes
  local original = stream.recent[bytes] or stream.older[bytes]
  if original and is_copy(stream, original, packet) then
    local index = original.number % MAX_KEPT
    stream.copies[index] = stream.copies[index] + 1
    return stream.copies[index]
  end
  keep(stream, packet)
  return 0
end

return M
]=])
module("yapp.serial.senders", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- Who sends in UDP and TCP: names of senders, and which of them take a new port for each datagram.
-- Pure Lua.
--
--   192.168.1.12:40000   [fe80::1]:14550   192.168.1.10, with a new port for each datagram

local frame = require "yapp.wire.frame"
local memo = require "yapp.base.memo"

local M = {}

local byte, sub = string.byte, string.sub

local UDP, UDP_HEADER, TCP = 17, 8, 6
local MAX_LENGTH = 0x2400 -- of an IPv6 payload: 9,216 bytes
-- A sender changes its port if it has so many ports, each with few datagrams in a row, and hardly
-- one comes back.  While a capture goes on, more of them are needed, and more time: several
-- controllers behind one address may send for the first time, and all do so again within a second.
-- A port that is picked by chance comes back now and then: of 23, one in 1 % of captures.
local MIN_PORTS, MIN_PORTS_LIVE, MAX_RUN, MAX_BACK = 4, 16, 4, 1 / 16
local MIN_TIME = 1 -- seconds from its first port to one that is new

local Senders = {}
Senders.__index = Senders

local function new_sender()
  return {
    begin = nil,  -- when its first datagram came
    latest = nil, -- its latest port
    run = 0,      -- how many datagrams came from that in a row
    ports = {},   -- [port] = true
    count = 0,    -- how many ports
    back = 0,     -- how often a port came back, or had sent many datagrams
  }
end

-- Whether a sender takes new ports.
local function takes_new_ports(sender, count)
  return sender.count >= count and sender.back <= sender.count * MAX_BACK
end

--- Make the list of a capture's senders.
function M.new()
  return setmetatable({
    by_address = memo(new_sender),
    is_changing = {}, -- [address] = true: those that are known to do so
    short_names = {}, -- by name
    is_taken = {},    -- by short name
  }, Senders)
end

--- Return the name of a sender.
-- port  nil for any
function M.name(address, port)
  if not port then return address end
  local shape = address:find(":", 1, true) and "[%s]:%d" or "%s:%d"
  return shape:format(address, port)
end

--- Return a name whose first part is what differs from others: "…12:40000".
-- name  of M.name
function Senders:short(name)
  local short = self.short_names[name]
  if short then return short end
  short = name
  local address = name:match("^%[.*%]") or name:match("^[^:]*") -- the port stays
  for at = #address - 1, 2, -1 do
    local shorter = "…" .. sub(name, at + 1)
    local is_border = sub(name, at, at):find("[.:]")
    if is_border and not self.is_taken[shorter] then
      short = shorter
      break
    end
  end
  self.short_names[name], self.is_taken[short] = short, true
  return short
end

--- Note a datagram of YAPP.
-- address, port  of its sender
-- time           in seconds; 0 if it is not known
function Senders:note(address, port, time)
  local sender = self.by_address[address]
  if sender.latest == port then
    sender.run = sender.run + 1
    return
  end
  sender.begin = sender.begin or time
  if sender.ports[port] or sender.run > MAX_RUN then
    sender.back = sender.back + 1
  else
    sender.ports[port], sender.count = true, sender.count + 1
    local is_late = time - sender.begin >= MIN_TIME
    if is_late and takes_new_ports(sender, MIN_PORTS_LIVE) then self.is_changing[address] = true end
  end
  sender.latest, sender.run = port, 1
end

--- Return the name of the sender of a datagram: its address alone if it takes new ports.
function Senders:name_of(address, port)
  return M.name(address, not self.is_changing[address] and port)
end

-- Datagrams in the bytes of a file ----------------------------------------------------------------

-- Return an IPv6 address as Wireshark writes it.
local function ipv6_text(bytes)
  local groups, best, length = {}, nil, 1
  for i = 1, 8 do groups[i] = ("%x"):format(byte(bytes, 2 * i - 1) * 256 + byte(bytes, 2 * i)) end
  for i = 1, 8 do
    local stop = i
    while groups[stop] == "0" do stop = stop + 1 end
    if stop - i > length then best, length = i, stop - i end
  end
  if not best then return table.concat(groups, ":") end
  return table.concat(groups, ":", 1, best - 1) .. "::" ..
    table.concat(groups, ":", best + length)
end

local function ipv4_text(bytes, index)
  return ("%d.%d.%d.%d"):format(byte(bytes, index, index + 3))
end

-- Return the addresses of the IP header in front of an UDP or TCP header: of the sender and of the
-- receiver; nil if there is none.
-- index  of the UDP or TCP header
local function addresses_before(bytes, index, protocol)
  local v4, v6 = index - 20, index - 40
  if v4 > 0 and byte(bytes, v4) == 0x45 and byte(bytes, v4 + 9) == protocol then
    return ipv4_text(bytes, v4 + 12), ipv4_text(bytes, v4 + 16)
  end
  local version = v6 > 0 and byte(bytes, v6) or 0
  local is_v6 = version - version % 16 == 0x60 and byte(bytes, v6 + 6) == protocol
  -- Bytes of another packet may look like that: of 4,000 packets one does.
  if is_v6 and byte(bytes, v6 + 4) * 256 + byte(bytes, v6 + 5) <= MAX_LENGTH then
    return ipv6_text(sub(bytes, v6 + 8, v6 + 23)), ipv6_text(sub(bytes, v6 + 24, v6 + 39))
  end
end

-- Return an iterator over the starts of what may be frames.
local function frames_in(bytes)
  local start = 0
  return function()
    repeat
      start = frame.find(bytes, start + 1)
    until not start or frame.is_plausible(bytes, start)
    return start
  end
end

--- Note the datagrams in the first bytes of a file, whatever carries them: those that begin with a
-- frame.  So a sender has its name from its first message on.
function Senders:scan(bytes)
  for start in frames_in(bytes) do
    local index = start - UDP_HEADER
    local address = addresses_before(bytes, index, UDP)
    if address then self:note(address, byte(bytes, index) * 256 + byte(bytes, index + 1), 0) end
  end
  for address, sender in pairs(self.by_address) do
    self.is_changing[address] = takes_new_ports(sender, MIN_PORTS) or nil
    self.by_address[address] = nil
  end
end

-- Headers in front of a frame: without and with TCP's usual option.
local BEFORE = { { UDP, UDP_HEADER }, { TCP, 20 }, { TCP, 32 } }

-- Whether a header has its size in front of the frame: TCP says it, in words of four bytes.
local function has_size(bytes, index, row)
  if row[1] ~= TCP then return true end
  local offset = byte(bytes, index + 12)
  return (offset - offset % 16) / 4 == row[2]
end

-- Return the payload of the frame that a datagram begins with, nil if the frame ends in another.
local function first_payload(bytes, start)
  local _, size = frame.parse(bytes, start)
  local length = byte(bytes, start - 4) * 256 + byte(bytes, start - 3)
  local from, to = start + frame.HEADER, start + frame.HEADER + size - 1
  local is_inside = UDP_HEADER + frame.HEADER + size + frame.CRC_SIZE <= length
  return is_inside and to <= #bytes and sub(bytes, from, to) or nil
end

--- Return the conversations that have frames in the first bytes of a file.
-- returns  list of {
--   is_tcp
--   from, to  the sender and the receiver of the first frame, "address:port" each
--   payload   of this frame, nil if it is not known
--   port      the lower one, which is the server's }
function M.conversations(bytes)
  local list, is_there = {}, {}
  for start in frames_in(bytes) do
    for _, row in ipairs(BEFORE) do
      local index = start - row[2]
      local from, to
      if index > 0 and has_size(bytes, index, row) then
        from, to = addresses_before(bytes, index, row[1])
      end
      local a, b, c, d = byte(bytes, index, index + 3)
      local port, other = from and a * 256 + b, from and c * 256 + d
      local key = from and table.concat({ row[1], from, port, to, other }, " ")
      if key and not is_there[key] then
        is_there[key] = true
        list[#list + 1] = {
          is_tcp = row[1] == TCP,
          from = from .. ":" .. port,
          to = to .. ":" .. other,
          payload = row[1] == UDP and first_payload(bytes, start) or nil,
          port = math.min(port, other),
        }
      end
    end
  end
  return list
end

--- Return the options of tshark that decode conversations: a list of
-- "-d tcp.port==4001,yapp_serial".
function M.options(conversations)
  local list, is_there = {}, {}
  for _, conversation in ipairs(conversations) do
    local kind = conversation.is_tcp and "tcp" or "udp"
    local option = ("-d %s.port==%d,yapp_serial"):format(kind, conversation.port)
    if not is_there[option] then list[#list + 1] = option end
    is_there[option] = true
  end
  return list
end

return M
]=])
module("yapp.serial.streams", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The contents of packets of byte streams and datagrams: frames, and bytes of none.  Pure Lua.
--
-- Packets are added once, in the order of the capture.  Revisits ask by frame key.
--
--   packet 7   |end of A|good frame B|start of C|   findings A (of packets 6 and 7) and B, and the
--   packet 8   |end of C|                           pending bytes of C, which packet 8 shows
--
-- TCP segments bring their sequence numbers.  Bytes that came before are left out.  A segment
-- behind a gap waits for the missing one, until it is clear that the capture does not have it.
--
-- A datagram of whole frames is complete in itself.  Other datagrams are a byte stream, as of a
-- bridge from a serial line, which cuts where it likes.  A lost one costs the frames it cut.
--
-- Such datagrams may be recorded twice: the copies are another stream, of which only good frames
-- count.
--
-- A conversation may be unknown when its first bytes come: they are on trial.

local memo = require "yapp.base.memo"
local repeats = require "yapp.serial.repeats"

local M = {}

local sub = string.sub

-- How long segments wait for a missing one: seconds, and bytes of the stream behind it.  A sender
-- usually repeats a segment within a second, and few send 64 KB ahead.
local MAX_WAIT, MAX_AHEAD = 1, 65535
-- A sequence number that differs by more is of a new connection.
local MAX_DISTANCE = 2 ^ 20
-- How many bytes of an unknown conversation are kept, and of how many conversations.
local MAX_TRIAL, MAX_TRIALS = 4096, 64
local MAX_HEADER = 24 -- bytes: in telnet each may be there twice

-- Stands for the contents of a packet of good frames alone: Streams:find reads its bytes anew.
local PLAIN = { findings = {}, pending = 0 }

local Streams = {}
Streams.__index = Streams

-- Besides the fields below, a stream has
--   latest    the latest packet; findings = those that it makes final
-- and of TCP, nil until they are known
--   next_seq  sequence number of the next byte
--   acked     what the other side has acknowledged
--   sent_seq  all bytes before it were sent, as the header of the segment sent_by shows
--   gap       the gap before the held segments, see Streams:drops
local function new_stream(framer)
  return {
    framer = framer,
    pieces = {},      -- contents with bytes in no finding yet: pieces[first] to pieces[last]
    first = 1,
    last = 0,
    is_ended = false, -- whether a new TCP connection has begun
    is_cut = false,   -- whether a frame went on in another packet
    held = {},        -- contents of the segments behind a gap, by sequence number
  }
end

--- Make the streams of a capture.
-- new_framer  function() -> a serial.framer
-- can_judge   function(time): whether time stamps tell what is a copy
function M.new(new_framer, can_judge)
  return setmetatable({
    new_framer = new_framer,
    can_judge = can_judge,
    repeats = repeats.new(can_judge),
    copies_by_key = memo(function() return new_stream(new_framer()) end),
    reader = new_framer(), -- of bytes that are complete in themselves, see Streams:read
    by_key = memo(function() return new_stream(new_framer()) end),
    trials = {}, -- by key, of unknown conversations: { framer, repeats, packets }
    trial_count = 0,
    trials_by_tag = {}, -- how many, by tag of serial.lines
    contents_by_key = {}, -- by frame key: the results of Streams:add
    seqs = {},     -- by key, of TCP: the sequence number that follows others' bytes
    gaps = {},     -- those that were not filled, see Streams:drops
  }, Streams)
end

-- Findings ---------------------------------------------------------------------------------------

-- Add the bytes of a packet to its stream.
-- overlap  how many of them the stream has already
local function add_bytes(stream, contents, overlap)
  local framer, packet, findings = stream.framer, contents.packet, stream.findings
  contents.packet, contents.overlap, contents.from = nil, overlap, framer.to
  if packet.is_tcp then framer:expect_telnet() end
  framer:add(packet.bytes:sub(overlap + 1), packet.truncated, findings)
  contents.to = framer.to
  local last = findings[#findings]
  if packet.truncated and last and last.missing then last.status = "truncated" end
  stream.last = stream.last + 1
  stream.pieces[stream.last] = contents
end

-- Note where the bytes of a finding are.
-- contents  of the packet that shows it
local function locate(stream, finding, contents)
  local from = contents.from
  if finding.from >= from and finding.to <= contents.to then
    if finding.is_telnet then return end
    finding.offset, finding.bytes = contents.overlap + finding.from - from, nil
    return
  end
  if finding.status == "skipped" then return end
  stream.is_cut, finding.packet_keys = true, {}
  for i = stream.first, stream.last do
    local piece = stream.pieces[i]
    if piece.from < finding.to and piece.to > finding.from then
      finding.packet_keys[#finding.packet_keys + 1] = piece.key
      if piece ~= contents then piece.leads_to = contents.key end
    end
  end
end

-- Drop the contents whose bytes all come before an offset.
local function drop_pieces(stream, offset)
  while stream.first <= stream.last and stream.pieces[stream.first].to <= offset do
    stream.pieces[stream.first] = nil
    stream.first = stream.first + 1
  end
end

-- TCP --------------------------------------------------------------------------------------------

-- Return how far one sequence number is ahead of another; they count modulo 2^32.
local function distance(seq, other)
  return (seq - other + 0x80000000) % 0x100000000 - 0x80000000
end

-- Keep a segment in the order of the sequence numbers.
local function hold(stream, contents)
  local held, seq, index = stream.held, contents.packet.seq, #stream.held + 1
  while index > 1 and distance(seq, held[index - 1].packet.seq) < 0 do index = index - 1 end
  table.insert(held, index, contents)
end

-- Whether the capture does not have the segment that others wait for.
local function is_lost(stream, packet)
  return stream.acked and distance(stream.acked, stream.next_seq) > 0 or
    distance(packet.seq, stream.next_seq) > MAX_AHEAD or
    packet.epoch - stream.gap.time > MAX_WAIT
end

-- Return the gap that a segment shows, see Streams:drops.
local function new_gap(stream, segment)
  local bus = stream.latest.bus_name
  return { time = segment.epoch, frame = segment.number, bus = bus, count = 1 }
end

-- Return the gap at the end of a connection, nil for none.
local function last_gap(stream)
  local sent_seq = stream.sent_seq
  if sent_seq and distance(sent_seq, stream.next_seq) > 0 then
    return new_gap(stream, stream.sent_by)
  end
end

-- Add the waiting segments that are in order; go on behind a gap if its segment is lost.
-- is_over  whether no missing segment will come
local function add_held(self, stream, is_over)
  local held, latest = stream.held, stream.latest
  while held[1] do
    local segment = held[1].packet
    local overlap = distance(stream.next_seq, segment.seq)
    if overlap < 0 then
      stream.gap = stream.gap or new_gap(stream, latest)
      if not is_over and not is_lost(stream, latest) then return end
      stream.framer:add("", true, stream.findings)
      table.insert(self.gaps, stream.gap)
      overlap, stream.gap = 0, nil
    end
    local contents = table.remove(held, 1)
    if overlap < segment.length then
      add_bytes(stream, contents, overlap)
      stream.next_seq, stream.gap = (segment.seq + segment.length) % 0x100000000, nil
    else
      contents.packet = nil
    end
  end
end

-- Note that a segment's header shows that all bytes before a sequence number were sent: one less
-- than it says, as the end of a connection counts as a byte.
local function note_sent(stream, seq, segment)
  local next_seq = not stream.is_ended and stream.next_seq
  if not next_seq or distance(seq, next_seq) > MAX_DISTANCE then return end
  if distance(seq, stream.sent_seq or next_seq) > 0 then
    stream.sent_seq, stream.sent_by = seq, segment
  end
end

-- Take a segment, and those that waited for it.
local function add_segment(self, stream, contents)
  local packet = contents.packet
  local next_seq = stream.next_seq or self.seqs[packet.stream] or packet.seq
  if stream.is_ended or math.abs(distance(packet.seq, next_seq)) > MAX_DISTANCE then
    add_held(self, stream, true)
    stream.framer:add("", true, stream.findings)
    self.gaps[#self.gaps + 1] = last_gap(stream)
    next_seq, stream.is_ended, stream.sent_seq = packet.seq, false, nil
  end
  stream.next_seq = next_seq
  hold(stream, contents)
  add_held(self, stream, false)
end

--- Note the header of a TCP segment.
-- key       of its stream
-- opposite  key of the stream of the other direction
-- segment   of host.tcp
-- returns   whether the segment can be put in order: its stream and its next sequence number are
--           known
function Streams:note_header(key, opposite, segment)
  local stream, other = rawget(self.by_key, key), rawget(self.by_key, opposite)
  local ack = segment.ack
  if other and ack then
    if distance(ack, other.acked or ack - 1) > 0 then other.acked = ack end
    note_sent(other, ack - 1, segment)
  end
  if stream then
    if segment.is_syn then stream.is_ended, stream.acked = true, nil end
    note_sent(stream, segment.seq - 1, segment)
    return stream.next_seq
  end
  local seq, length = segment.seq, segment.length
  local overlap = distance(self.seqs[key] or seq, seq)
  if not segment.is_ours and overlap >= 0 and overlap <= length then
    self.seqs[key] = (seq + length) % 0x100000000
  end
end

-- Packets ----------------------------------------------------------------------------------------

-- Whether bytes hold good frames and nothing else.
local function is_plain(findings, bytes)
  local length = 0
  for _, finding in ipairs(findings) do
    if finding.status ~= "good" or not finding.offset then return false end
    length = length + finding.to - finding.from
  end
  return length == #bytes
end

--- Return the findings of bytes that are complete in themselves; each has its offset in them.
-- bytes  string
function Streams:read(bytes)
  local framer = self.reader
  local from = framer.to
  local findings = framer:add(bytes, true)
  for _, finding in ipairs(findings) do
    finding.offset, finding.bytes = finding.from - from, nil
  end
  return findings
end

-- Return the findings of a datagram that is complete in itself, nil for any other packet.
local function read_alone(self, packet)
  local is_complete = packet.is_complete
  if not (packet.is_datagram or is_complete) or packet.truncated then return nil end
  local findings = self:read(packet.bytes)
  return (is_complete or is_plain(findings, packet.bytes)) and findings or nil
end

-- Return the stream that a packet belongs to, and whether it is one of copies.
-- is_alone  whether the packet is complete in itself: then the messages in it tell what is a copy
local function stream_of(self, packet, is_alone)
  local key = packet.stream
  if is_alone or not packet.is_datagram then return self.by_key[key], false end
  local number = self.repeats:copy_number(packet)
  if number == 0 then return self.by_key[key], false end
  return self.copies_by_key[key .. "|" .. number], true
end

-- Remove all findings but good frames: bytes that were not recorded twice are no loss.
local function keep_good(findings)
  local count = 0
  for i, finding in ipairs(findings) do
    findings[i] = nil
    if finding.status == "good" then
      count = count + 1
      findings[count] = finding
    end
  end
end

-- Return how many bytes wait in a stream.
local function count_waiting(stream)
  return stream and stream.framer.to - stream.framer.from or 0
end

-- Whether a datagram is of others: it holds no frame, goes on with none and begins none.  A single
-- "Y" at the end of other bytes is chance, unless the datagrams are known to cut frames.
-- waited  number of bytes that waited for it
local function is_of_others(stream, contents, waited)
  for _, finding in ipairs(contents.findings) do
    if finding.status ~= "skipped" then return false end
  end
  local pending, length = contents.pending, contents.to - contents.from
  local is_begun = pending > 1 or pending == 1 and (stream.is_cut or length == 1)
  return waited == 0 and not is_begun
end

local function new_contents(packet, findings)
  return {
    key = packet.key,
    findings = findings,
    pending = 0,
    is_held = false,
    is_others = false,
    packet = packet, -- nil once its bytes are added
    overlap = 0,     -- number of its bytes that had come before
    from = 0,        -- offset in the stream of the others, once they are added
    to = 0,
  }
end

-- Add a packet to its stream; return its contents.
local function split_bytes(self, stream, contents)
  local packet, findings, framer = contents.packet, contents.findings, stream.framer
  stream.latest, stream.findings = packet, findings
  if packet.seq then
    add_segment(self, stream, contents)
  else
    add_bytes(stream, contents, 0)
  end
  for _, finding in ipairs(findings) do
    drop_pieces(stream, finding.from)
    locate(stream, finding, contents)
  end
  drop_pieces(stream, framer.from)
  if contents.packet then -- its bytes wait for a missing segment
    contents.is_held, contents.pending = true, #packet.bytes
  elseif contents.to > framer.from then
    contents.pending = contents.to - math.max(contents.from, framer.from)
    contents.missing = select(2, framer:open_frame())
  end
end

-- Note that the capture does not have the end of a packet: whole frames may be missing.
local function note_truncated(self, stream, packet, findings)
  local last = findings[#findings]
  if packet.truncated and not (last and last.missing) then
    table.insert(self.gaps, new_gap(stream, packet))
  end
end

--- Take the next packet of the capture.
-- packet  {
--   key          frame key; a second frame with this key replaces the first
--   number       of the packet; bus_name = or nil
--   epoch        of a segment, or if it is truncated: seconds since 1970
--   bytes        string: those that were captured
--   truncated    whether the packet had more
--   is_datagram, is_tcp  whether it is of UDP, of TCP
--   is_complete  whether it is what the framing of a raw dump found
--   is_found     whether its conversation was found by content: it may have datagrams of others
--   stream       key of the stream; tag = of its line
--   seq          of TCP, if it is known: sequence number of the first byte
--   length       number of bytes that it had }
-- is_stored  whether Streams:find may ask for it
-- returns  {
--   findings  as from serial.framer, or with the status "truncated": the capture has only a part
--             of the frame; and offset = in the packet.  If not all its bytes are in this packet:
--             bytes = string, and packet_keys = of the packets they came in (none of skipped
--             bytes).  Of a frame of telnet: bytes = those before telnet
--   pending   number of bytes at the end that are in no finding yet
--   is_held   whether it is a segment that waits for a missing one: then all are pending
--   missing   number of bytes to come of the frame that the pending ones begin, or nil
--   is_others whether it is a datagram of others: nothing else of it holds
--   leads_to  key of the packet that shows the pending bytes, nil until it has come }
function Streams:add(packet, is_stored)
  local whole = read_alone(self, packet)
  if whole and count_waiting(rawget(self.by_key, packet.stream)) == 0 then
    if is_stored then self.contents_by_key[packet.key] = PLAIN end
    return new_contents(packet, whole)
  end
  local stream, is_copy = stream_of(self, packet, whole)
  local waited, findings = count_waiting(stream), {}
  local contents = new_contents(packet, findings)
  -- What waits was cut by a lost datagram if the next one is complete in itself.
  if whole then stream.framer:add("", true, findings) end
  split_bytes(self, stream, contents)
  if packet.is_found and packet.is_datagram and is_of_others(stream, contents, waited) then
    stream.framer:add("", true)
    drop_pieces(stream, stream.framer.from)
    contents.is_others = true
    return contents
  end
  if is_copy then keep_good(findings) else note_truncated(self, stream, packet, findings) end
  if is_stored then
    local can_be_read_anew = not packet.is_datagram and is_plain(findings, packet.bytes)
    self.contents_by_key[packet.key] = can_be_read_anew and PLAIN or contents
  end
  return contents
end

--- Return the contents of a packet that was added before, nil if it was not.
function Streams:find(packet)
  local contents = self.contents_by_key[packet.key]
  if contents ~= PLAIN then return contents end
  return new_contents(packet, self:read(packet.bytes))
end

--- Return whether a packet was added before, and stored.
function Streams:is_stored(key)
  return self.contents_by_key[key] ~= nil
end

-- Whether a frame may begin in bytes of an unknown conversation.
local function has_start(bytes)
  return bytes:find("YP", 1, true) or sub(bytes, -1) == "Y"
end

--- Return whether a frame may begin in a packet of an unknown conversation.
Streams.may_begin = has_start

--- Return whether a packet of an unknown conversation may go on with a frame.
-- tag  of its line
function Streams:may_go_on(tag)
  return self.trials_by_tag[tag] ~= nil
end

local function count_trial(self, tag, change)
  local by_tag = self.trials_by_tag
  local count = (by_tag[tag] or 0) + change
  self.trial_count, by_tag[tag] = self.trial_count + change, count > 0 and count or nil
end

-- Begin the trial of a conversation, if a frame may begin in its bytes.
local function new_trial(self, packet)
  if not has_start(packet.bytes) then return nil end
  if self.trial_count >= MAX_TRIALS then
    self.trials, self.trials_by_tag, self.trial_count = {}, {}, 0
  end
  local trial = {
    framer = self.new_framer(),
    repeats = repeats.new(self.can_judge),
    packets = {},
    tag = packet.tag,
  }
  if packet.is_tcp then trial.framer:expect_telnet() end
  self.trials[packet.stream] = trial
  count_trial(self, trial.tag, 1)
  return trial
end

-- Whether bytes of a trial show that it is YAPP.
local function is_proof(framer, findings)
  for _, finding in ipairs(findings) do
    if finding.status == "good" then return true end
  end
  return framer:has_known()
end

--- End the trial of a conversation.
-- key      of its stream
-- returns  list of the packets that came so far; empty if it has none
function Streams:end_trial(key)
  local trial = self.trials[key]
  if not trial then return {} end
  self.trials[key] = nil
  count_trial(self, trial.tag, -1)
  return trial.packets
end

-- Keep a packet of a trial, if bytes of it may go on: with a plausible header, or the start of one.
local function goes_on(trial, packet)
  local framer = trial.framer
  local pending = framer.to - framer.from
  if pending == 0 or pending > MAX_TRIAL then return false end
  if pending >= MAX_HEADER and not framer:open_frame() then return false end
  table.insert(trial.packets, packet)
  return true
end

-- Whether a trial has had the bytes of a packet: by its port, and then by the heuristics; or in the
-- packet that it is a copy of.  A copy that proves that it is YAPP is taken.
local function was_had(trial, packet, is_proved)
  local packets = trial.packets
  local latest = packets[#packets]
  if latest and latest.key == packet.key then return true end
  if is_proved or not packet.is_datagram then return false end
  if trial.repeats:copy_number(packet) == 0 then return false end
  packets[#packets + 1] = packet
  return true
end

-- Whether a good frame begins before an offset.
local function is_good_before(findings, offset)
  for _, finding in ipairs(findings) do
    if finding.status == "good" then return finding.from < offset end
  end
  return false
end

--- Take a packet of an unknown conversation on trial.
-- packet     as of Streams:add
-- is_proved  whether the packet alone shows that it is YAPP
-- returns    nil, unless the bytes that came so far have a frame, or the header of a message of the
--            catalogue.  Then the list of the earlier packets, for Streams:add.  If they do not
--            belong to the packet's first frame, they may be of others: is_found is set
function Streams:try(packet, is_proved)
  local trial = self.trials[packet.stream] or not is_proved and new_trial(self, packet)
  if not trial then return is_proved and {} or nil end
  if was_had(trial, packet, is_proved) then return nil end
  local framer = trial.framer
  local from = framer.to
  local findings = framer:add(packet.bytes, packet.truncated)
  local is_found = is_proved or is_proof(framer, findings)
  if not is_found and goes_on(trial, packet) then return nil end
  local packets = self:end_trial(packet.stream)
  if not is_found then return nil end
  local is_joined = not is_proved or is_good_before(findings, from)
  for _, earlier in ipairs(packets) do earlier.is_found = not is_joined end
  return packets
end

--- Whether the capture ends before the frame that a packet's pending bytes begin.
function Streams:is_unfinished(contents, packet)
  if contents.pending == 0 or contents.leads_to then return false end
  local stream = self.by_key[packet.stream]
  return stream.latest.key == packet.key and stream.framer:open_frame()
end

-- Return what waits in a stream: its pending bytes, and the segments behind each gap.
-- returns  list of { bytes, packet = the stream's latest; behind a gap the last with some of them }
local function waiting(stream)
  local last = { bytes = stream.framer:pending(), packet = stream.latest }
  local list, next_seq = { last }, stream.next_seq
  for _, contents in ipairs(stream.held) do
    local packet = contents.packet
    local overlap = distance(next_seq, packet.seq)
    if overlap < 0 then
      last, overlap = { bytes = "" }, 0
      list[#list + 1] = last
    end
    if overlap < packet.length then
      last.bytes, last.packet = last.bytes .. sub(packet.bytes, overlap + 1), packet
      next_seq = (packet.seq + packet.length) % 0x100000000
    end
  end
  return list
end

--- Return what the streams hold beside the contents of packets, if the capture ends here.
-- returns  list of { packet = see above, findings = as from Streams:add, each with its bytes, and
--          offset = in these }
function Streams:unfinished()
  local list = {}
  for _, stream in pairs(self.by_key) do
    for _, piece in ipairs(waiting(stream)) do
      piece.findings = self:read(piece.bytes)
      for _, finding in ipairs(piece.findings) do finding.bytes = piece.bytes end
      list[#list + 1] = piece
    end
  end
  return list
end

--- Return what the capture does not have: segments of TCP connections, the ends of packets.
-- returns  list of { time = seconds since 1970, frame = number of the packet behind the gap,
--          bus = name or nil, count = 1 }
function Streams:drops()
  local list = {}
  for _, gap in ipairs(self.gaps) do list[#list + 1] = gap end
  for _, stream in pairs(self.by_key) do list[#list + 1] = stream.gap or last_gap(stream) end
  table.sort(list, function(a, b) return a.frame < b.frame end)
  return list
end

return M
]=])
module("yapp.serial.transfers", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- From a finding of serial.framer to a transfer.  Pure Lua.

local crc = require "yapp.wire.crc"
local frame = require "yapp.wire.frame"

local M = {}

local sub = string.sub
local HEADER, CRC_SIZE = frame.HEADER, frame.CRC_SIZE

-- List the errors of a frame, but for its CRC; false for none.
local function anomalies_of(transfer)
  local list, missing = {}, transfer.missing
  if missing then
    local text = "%d of the frame's %d bytes are missing"
    list[1] = {
      expert = transfer.status == "truncated" and "truncated" or "fragment.incomplete",
      text = text:format(missing, HEADER + transfer.size + CRC_SIZE),
    }
  end
  if transfer.reserved ~= 0 then
    local text = "The reserved bytes are 0x%04x, not 0"
    list[#list + 1] = { expert = "reserved.nonzero", text = text:format(transfer.reserved) }
  end
  return list[1] and list or false
end

--- Make the transfer of a finding.
-- finding  that is not skipped
-- bytes    that hold it, from its offset on
-- returns  the transfer, and the ID and the Seq No of its header, and its anomalies: a list of
--          { expert, text }, or false.  The transfer is {
--   status       "good", "bad" (CRC), "incomplete", "truncated" (by the capture)
--   size         of the payload, as its header has it; reserved = its reserved bytes
--   payload      the bytes of it that came
--   offset       of the frame in the bytes; length = number of its bytes that came
--   missing      number of bytes to come, nil for none
--   bytes        that hold it if those of its packet do not, or nil
--   packet_keys  of the packets that these came in, or nil
--   crc, calculated  of a bad one }
function M.new(finding, bytes)
  local offset = finding.offset or 0
  local length = finding.is_telnet and #finding.bytes or finding.to - finding.from
  local id, size, reserved, seq = frame.parse(bytes, offset + 1)
  local transfer = {
    status = finding.status,
    size = size,
    reserved = reserved,
    payload = sub(bytes, offset + HEADER + 1, offset + math.min(HEADER + size, length)),
    offset = offset,
    length = length,
    missing = finding.missing,
    bytes = finding.bytes,
    packet_keys = finding.packet_keys,
    crc = nil,
    calculated = nil,
  }
  if finding.status == "bad" then
    local last = offset + length
    transfer.crc = frame.crc(bytes, last)
    transfer.calculated = crc.update(crc.INITIAL, bytes, offset + 1, last - CRC_SIZE)
  end
  local is_usual = reserved == 0 and not finding.missing
  return transfer, id, seq, not is_usual and anomalies_of(transfer)
end

return M
]=])
module("yapp.serial.usb", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- Serial lines at their USB adapter: CDC-ACM, CP210x, CH340, FTDI and others, in packets of usbmon
-- (Linux) and USBPcap (Windows).  Pure Lua.
--
-- Their bulk endpoints carry the bytes of the line as they are.  FTDI's adapters put two bytes of
-- status in front of each packet of the bus, of which a transfer may have several:
--
--   01 60 59 50 ...   62 bytes of the line behind 2 of status, then again 2 and up to 62

local M = {}

local byte, find, floor, sub = string.byte, string.find, math.floor, string.sub

local CONTROL, BULK = 2, 3 -- transfers
local SUBMIT, COMPLETE = byte("S"), byte("C") -- events of usbmon
local DEVICE, CONFIGURATION, ENDPOINT = 1, 2, 5 -- descriptors
local FTDI = 0x0403 -- vendor
local STATUS = 2 -- bytes
local FULL_SPEED, HIGH_SPEED = 64, 512 -- the largest packet of a bulk endpoint

local function u16(bytes, offset)
  local a, b = byte(bytes, offset + 1, offset + 2)
  return a + b * 0x100
end

local function u32(bytes, offset)
  return u16(bytes, offset) + u16(bytes, offset + 2) * 0x10000
end

-- Headers -----------------------------------------------------------------------------------------

-- By kind of packet: function(bytes) -> { bus, device, endpoint, transfer; offset, length = of its
-- data }; nil for a packet without data that came in or went out.
local HEADERS = {}

local function usbmon(size)
  return function(bytes)
    if #bytes < size then return nil end
    local event, transfer, endpoint, device = byte(bytes, 9, 12)
    local has_data = byte(bytes, 16) == 0
    if not has_data or event ~= (endpoint >= 0x80 and COMPLETE or SUBMIT) then return nil end
    return {
      bus = u16(bytes, 12),
      device = device,
      endpoint = endpoint,
      transfer = transfer,
      offset = size,
      length = u32(bytes, 32),
    }
  end
end

HEADERS.usbmon = usbmon(48)
HEADERS.usbmon_mapped = usbmon(64)

function HEADERS.usbpcap(bytes)
  if #bytes < 27 then return nil end
  local endpoint, is_complete = byte(bytes, 22), byte(bytes, 17) % 2 == 1
  if is_complete ~= (endpoint >= 0x80) then return nil end
  return {
    bus = u16(bytes, 17),
    device = u16(bytes, 19),
    endpoint = endpoint,
    transfer = byte(bytes, 23),
    offset = u16(bytes, 0),
    length = u32(bytes, 23),
  }
end

-- Packets of others -------------------------------------------------------------------------------

local Y, P = byte("YP", 1, 2)
local TRANSFER = { usbmon = 10, usbmon_mapped = 10, usbpcap = 23 } -- index in the header
local DATA = { usbmon = 48, usbmon_mapped = 64 } -- offset; usbpcap has it in its first byte

--- Whether a packet need not be read while no line with YAPP is known: no frame begins in its data,
-- and it describes no device.  Most packets of others are so, and the test is quick.
-- kind, bytes  as of Usb:read
function M.is_of_others(kind, bytes)
  local transfer = byte(bytes, TRANSFER[kind])
  if transfer ~= BULK then return transfer ~= CONTROL end
  if find(bytes, "YP", 1, true) or byte(bytes, -1) == Y then return false end
  -- A status may stand between the first two bytes of a frame.
  for index = (DATA[kind] or byte(bytes)) + FULL_SPEED, #bytes, FULL_SPEED do
    if byte(bytes, index) == Y and byte(bytes, index + STATUS + 1) == P then return false end
  end
  return true
end

-- Devices -----------------------------------------------------------------------------------------

local Usb = {}
Usb.__index = Usb

--- Make the facts of a capture's devices.
function M.new()
  return setmetatable({
    devices = {}, -- by bus and address
  }, Usb)
end

-- Read the description of a device; return nil.
local function read_descriptors(device, data)
  local offset = 0
  while offset + 2 <= #data do
    local length, kind = byte(data, offset + 1, offset + 2)
    if length < 2 or offset + length > #data then return end
    if kind == DEVICE and length == 18 then
      device.vendor, device.sizes = u16(data, offset + 8), {}
    elseif kind == ENDPOINT and length >= 7 then
      device.sizes[byte(data, offset + 3)] = u16(data, offset + 4) % 0x800
    elseif offset == 0 and kind ~= CONFIGURATION then
      return
    end
    offset = offset + length
  end
end

-- Return the size of FTDI's packets, by the status in front of the first one; nil for no status.
local function size_by_status(data)
  local modem, line = byte(data, 1, STATUS)
  if not line or floor(line / 2) % 16 ~= 0 or line >= 128 then return nil end
  return modem % 16 == 1 and FULL_SPEED or modem % 16 == 2 and HIGH_SPEED or nil
end

-- Return the size of the packets with a status in front, nil if the data is as on the line.  If the
-- capture does not have the device's descriptors, all that it sends must begin with a status.
local function status_size(device, endpoint, data)
  if endpoint < 0x80 or device.vendor and device.vendor ~= FTDI then return nil end
  local size = size_by_status(data)
  if device.vendor then return device.sizes[endpoint] or size or FULL_SPEED end
  device.has_status = device.has_status ~= false and size ~= nil
  return device.has_status and size or nil
end

-- Return data without the status in front of each packet.
local function without_status(data, size)
  local parts = {}
  for offset = 0, #data - 1, size do
    parts[#parts + 1] = sub(data, offset + STATUS + 1, offset + size)
  end
  return table.concat(parts)
end

-- Return the device of a packet, which may be new.
local function device_of(self, header)
  local number = header.bus * 0x10000 + header.device
  local device = self.devices[number]
  if not device then
    device = { name = ("usb%d.%d"):format(header.bus, header.device), sizes = {}, lines = {} }
    self.devices[number] = device
  end
  return device
end

-- Return the line of an endpoint, see Usb:read.
local function line_of(device, endpoint)
  local line = device.lines[endpoint]
  if not line then
    local name = ("%s.%d"):format(device.name, endpoint % 0x80)
    local rx, tx = name .. "#rx", name .. "#tx"
    local is_in = endpoint >= 0x80
    line = { name = is_in and rx or tx, opposite = is_in and tx or rx, device = device.name }
    device.lines[endpoint] = line
  end
  return line
end

--- Read a packet.
-- kind   of HEADERS: "usbmon", "usbmon_mapped", "usbpcap"
-- bytes  those that were captured
-- returns  nil if it has no bytes of a line, else {
--   line       {
--     name      usb1.6.1#rx, of endpoint 1; rx is from the adapter to the host
--     opposite  name of the other direction of its endpoint
--     device    name of the adapter: usb1.6, of bus 1 and address 6 }
--   bytes      of the line
--   offset     of its data in the packet
--   has_status  whether there is more than the bytes of the line
--   truncated  whether the packet had more }
function Usb:read(kind, bytes)
  local header = HEADERS[kind](bytes)
  local transfer = header and header.transfer
  if transfer ~= BULK and transfer ~= CONTROL then return nil end
  local device, data = device_of(self, header), sub(bytes, header.offset + 1)
  if transfer == CONTROL then return read_descriptors(device, data) end
  if data == "" then return nil end
  local size, length = status_size(device, header.endpoint, data), #data
  return {
    line = line_of(device, header.endpoint),
    bytes = size and without_status(data, size) or data,
    offset = header.offset,
    has_status = size ~= nil,
    truncated = length < header.length,
  }
end

return M
]=])
module("yapp.show.fields", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- Makes the fields and expert items, YAPP's own from the rows below, those of messages from the
-- compiled catalogue; and adds them to a tree.  Wireshark's API.
--
-- A field of YAPP's is a row of YAPP, an expert item a row of EXPERTS.

local M = {}

local unpack = rawget(table, "unpack")
local FRAME_KINDS = { [0] = "Single", "Start", "Middle", "End" }
local CRC_STATUS = { [0] = "Bad", "Good", "Unverified" }

-- filter, type, title, description, base, values
local YAPP = {
  { "id", "UINT32", "Message ID",
    "Message ID: which message it is, and which controller sent it", "HEX" },
  { "ctl", "UINT8", "Control (CTL)",
    "YAPP's control byte" },
  { "seq", "UINT8", "Sequence number",
    "Numbers the messages of a source, from 0 to 255" },
  { "size", "UINT16", "Payload size",
    "Payload of the message in bytes" },
  { "reserved", "UINT16", "Reserved",
    "Reserved bytes of the header, 0", "HEX" },
  { "sync", "UINT16", "Sync",
    "The bytes YP, with which a frame in a stream begins", "HEX" },
  { "can.ctrl", "UINT8", "CAN frame",
    "Which part of a message a CAN frame is", nil, FRAME_KINDS },
  { "crc", "UINT32", "CRC",
    "CRC-32K of header and payload, as it was sent", "HEX" },
  { "crc.status", "UINT8", "CRC status",
    "Whether the CRC is that of the bytes", nil, CRC_STATUS },
  { "crc.calculated", "UINT32", "Calculated CRC",
    "What the CRC should be, where it is bad", "HEX" },
  { "payload", "BYTES", "Payload",
    "Payload that the catalogue does not explain" },
  { "undecoded", "BYTES", "Not decoded",
    "Payload behind the last field that the catalogue has" },
  { "padding", "BYTES", "CAN FD padding",
    "Bytes that fill a CAN FD frame" },
  { "fragments", "NONE", "Fragments",
    "The frames that a message was put together from" },
  { "fragment", "FRAMENUM", "Fragment",
    "A frame of the message" },
  { "fragment.data", "BYTES", "Fragment data",
    "What a frame has of the message's payload" },
  { "fragment.count", "UINT32", "Fragment count",
    "How many frames the message came in" },
  { "reassembled.in", "FRAMENUM", "Reassembled in",
    "The frame in which the message ends" },
  { "reassembled.length", "UINT32", "Reassembled length",
    "Bytes that were put together" },
  { "reassembled.data", "BYTES", "Reassembled data",
    "Payload that came in several frames" },
  { "skipped", "BYTES", "Skipped bytes",
    "Bytes of a stream that belong to no frame" },
  { "time_delta", "RELATIVE_TIME", "Time since the previous message with this ID",
    "Since the previous message with this ID on this bus or stream" },
  { "bus", "STRING", "Bus",
    "Name of the bus, where the capture has one" },
  { "source", "STRING", "Source",
    "The name from yapp.sources; without one the ID, behind the bus if there are several" },
  { "message.fault", "BOOLEAN", "Message has a fault flag set",
    "Set in every frame of a message that has a fault" },
  { "copy_of", "FRAMENUM", "Copy of the message in",
    "The frame of the same message that was recorded before" },
  { "seq.missing", "UINT8", "Messages missing before this one",
    "How many messages are missing before this one, by sequence number" },
}

-- Expert items: filter, text, group, severity.  The text is the same each time, so that `-z expert`
-- counts it; numbers stand in the item's label, see M.add_expert.  Of a change:
--   change  its name in message.history
--   label   of the item, with the number of the change; nil for the text
--   word    in the Info column, or nil
local EXPERTS = {
  { "yapp.crc.bad", "Bad CRC", "CHECKSUM", "ERROR" },
  { "yapp.fragment.orphan", "Middle or End without a Start", "SEQUENCE", "WARN" },
  { "yapp.fragment.incomplete", "Message with bytes missing", "REASSEMBLE", "WARN" },
  { "yapp.fragment.overrun", "More bytes than the message's size", "REASSEMBLE", "WARN" },
  { "yapp.fragment.duplicate", "Frame delivered twice", "SEQUENCE", "NOTE" },
  { "yapp.copy", "Message that was recorded twice", "SEQUENCE", "NOTE" },
  { "yapp.unfinished", "Message cut off by the end of the capture", "REASSEMBLE", "WARN" },
  { "yapp.late", "A long gap before this message", "SEQUENCE", "WARN",
    change = "late", label = "Silent for %.3f s" },
  { "yapp.size.mismatch", "Payload length is not the catalogue's", "PROTOCOL", "WARN" },
  { "yapp.id.unknown", "Message ID is not in the catalogue", "UNDECODED", "NOTE" },
  { "yapp.reserved.nonzero", "Reserved bytes are not 0", "PROTOCOL", "WARN" },
  { "yapp.can.ctrl.invalid", "CAN CTRL is not defined", "PROTOCOL", "WARN" },
  { "yapp.can.id.missing", "The CAN id of this frame is not known", "UNDECODED", "WARN" },
  { "yapp.stream.skipped", "Bytes that belong to no frame", "SEQUENCE", "NOTE" },
  { "yapp.truncated", "The capture cut the packet short", "MALFORMED", "WARN" },
  { "yapp.source.shared", "Two controllers send this ID on one bus: their clocks alternate",
    "SEQUENCE", "WARN", change = "shared" },
  { "taurus.fault.active", "Fault flags are set", "RESPONSE_CODE", "ERROR" },
  { "taurus.fault.raised", "A fault was raised", "RESPONSE_CODE", "ERROR" },
  { "taurus.fault.cleared", "A fault was cleared", "RESPONSE_CODE", "NOTE" },
  { "taurus.reboot", "Controller rebooted (its clock went back)", "SEQUENCE", "WARN",
    change = "reboot", label = "Controller rebooted (its clock went back by %.1f s)",
    word = "REBOOT" },
  { "taurus.stale", "Controller clock did not advance", "SEQUENCE", "WARN",
    change = "stale", word = "STALE" },
  { "taurus.jump", "Controller's clock jumped ahead", "SEQUENCE", "WARN",
    change = "jump", label = "Controller's clock jumped ahead by %.1f s", word = "JUMP" },
  { "taurus.command.key.invalid", "Key is not defined (the controller ignores this command)",
    "PROTOCOL", "WARN" },
  { "taurus.value.special", "Reserved value: not a number, infinite or out of range",
    "PROTOCOL", "NOTE" },
  { "taurus.flags.undefined", "A bit is set that no table defines", "PROTOCOL", "NOTE" },
  { "taurus.value.invalid", "Value that is not defined", "PROTOCOL", "WARN" },
}

--- The filter names of all expert items: { [name] = true }.
M.EXPERT_NAMES = {}
--- The rows of the expert items of changes.
M.CHANGES = {}
for _, row in ipairs(EXPERTS) do
  M.EXPERT_NAMES[row[1]] = true
  if row.change then table.insert(M.CHANGES, row) end
end

-- Make a field of the columns of a row behind its filter: type, title, description, base, values,
-- mask.
-- shape   base of a number, by its name in the API; or the width in bits of a boolean's field
-- values  a table, or the name of a type of frame
local function new_field(filter, kind, title, about, shape, values, mask)
  shape = shape or kind:find("INT") and "DEC" or "NONE"
  values = kind == "FRAMENUM" and frametype[values or "NONE"] or values
  return ProtoField.new(title, filter, ftypes[kind], values, base[shape] or shape, mask, about)
end

local experts = {} -- [filter] = ProtoExpert, made once, when the plugin loads

-- Give a protocol its fields, and the expert items whose filters begin with this prefix.
local function define(proto, prefix, fields)
  local own = {}
  for _, row in ipairs(EXPERTS) do
    local name, text, group, severity = row[1], row[2], row[3], row[4]
    if name:find(prefix, 1, true) == 1 then
      own[name] = ProtoExpert.new(name, text, expert.group[group], expert.severity[severity])
      experts[name] = own[name]
    end
  end
  proto.fields, proto.experts = fields, own
end

--- Make YAPP's own fields and expert items and hand them to the protocol.
-- yapp     Proto
-- names    { [id] = title } of the messages that are known
-- messages of the catalogue
-- returns  { [filter without "yapp."] = ProtoField }
function M.of_yapp(yapp, names, messages)
  local fields = {}
  for _, row in ipairs(YAPP) do
    local name = row[1]
    if name == "id" then row[6] = names end
    fields[name] = new_field("yapp." .. name, unpack(row, 2, 6))
  end
  for _, message in ipairs(messages) do
    local name = "like." .. message.name
    fields[name] = new_field("yapp." .. name, "UINT32", "Could be " .. message.title,
      "ID that is not in the catalogue, of a message with the size of " .. message.title, "HEX")
  end
  define(yapp, "yapp.", fields)
  return fields
end

--- Make the fields and expert items of the messages and hand them to the protocol.
-- taurus    Proto
-- messages  of the catalogue
-- returns   { [filter] = ProtoField }
function M.of_taurus(taurus, messages)
  local fields = {}
  for _, message in ipairs(messages) do
    for _, row in ipairs(message.filters) do fields[row[1]] = new_field(unpack(row, 1, 7)) end
  end
  define(taurus, "taurus.", fields)
  return fields
end

-- Adding items ------------------------------------------------------------------------------------

-- As functions, the item first: a method that Lua has to look up in an item costs a third of what
-- adding a field does.
local add = TreeItem.add
local set_generated = TreeItem.set_generated
M.add = add
M.add_le = TreeItem.add_le
M.append_text = TreeItem.append_text
M.set_generated = set_generated -- no bytes of the packet hold the item's value

--- Add an expert item.
-- item  nil in a tap, which has no tree
-- name  its filter
-- text  about this packet, or nil.  It becomes a generated item, as the expert item's own text
--       stays the same for all packets
function M.add_expert(item, name, text)
  if not item then return end
  if text and item.visible then item = set_generated(add(item, text)) end
  item:add_proto_expert_info(experts[name])
end

--- Return seconds, a double, as a time to the nanosecond.
function M.relative_time(seconds)
  local sign = seconds < 0 and -1 or 1
  local whole, rest = math.modf(sign * seconds)
  rest = math.floor(rest * 1e9 + 0.5)
  if rest == 1e9 then whole, rest = whole + 1, 0 end
  return NSTime.new(sign * whole, sign * rest)
end

return M
]=])
module("yapp.show.frame", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The view of a CAN frame: its tree, its expert items, its columns.  One function for each
-- kind of result.  Wireshark's API.

local can_id = require "yapp.wire.can_id"
local show_fields = require "yapp.show.fields"
local number_of = require "yapp.base.frame_key".number

local M = {}

local CTRL_NAMES, START = can_id.CTRL_NAMES, can_id.START
local add, add_le, append_text = show_fields.add, show_fields.add_le, show_fields.append_text
local set_generated = show_fields.set_generated

local FrameView = {}
FrameView.__index = FrameView

--- Make the view of CAN frames.
-- builder  a show.tree
function M.new(builder)
  return setmetatable({
    builder = builder,
    fields = builder.fields,
    -- Of the current frame; see Tree:show_message:
    tvb = false, -- where its bytes are
    range = false, -- all of them, if YAPP's own item is wanted
    tree = false,
    item = false,
    wants = false,
    payload_tvb = false,
    payload_offset = 0,
  }, FrameView)
end

-- YAPP's own item ---------------------------------------------------------------------------------

-- Add YAPP's own item, with the fields of the CAN id as generated items.
local function add_item(self, frame)
  local builder, fields, of_id, source = self.builder, self.fields, frame.can_id, frame.source
  local kind = CTRL_NAMES[of_id.ctrl] or "undefined frame"
  self.range = self.tvb()
  local item = add(self.tree, builder.yapp, self.range)
  append_text(item, (", %s, %s"):format(source.short, kind))
  builder:add_id(item, nil, source)
  set_generated(add(item, fields.ctl, of_id.ctl))
  set_generated(add(item, fields.seq, of_id.seq))
  set_generated(add(item, fields["can.ctrl"], of_id.ctrl))
  builder:add_source(item, source)
  return item
end

-- Add the fields in the bytes of a fragment.  A truncated Start has only the fields that were
-- captured.
local function add_fragment(self, result)
  local fields, length, item = self.fields, #result.frame.data, self.item
  if result.frame.can_id.ctrl ~= START then
    if length > 0 then add(item, fields["fragment.data"], self.range) end
    return
  end
  if length >= 4 then add_le(item, fields.crc, self.tvb(0, 4)) end
  if length >= 6 then append_text(add_le(item, fields.size, self.tvb(4, 2)), " bytes") end
  if length >= 8 then add_le(item, fields.reserved, self.tvb(6, 2)) end
  if result.transfer then append_text(item, (" of %d bytes"):format(result.transfer.size)) end
end

-- Add the parts that the last or only frame of a transfer completes: size, CRC, fragments and
-- padding.
local function add_transfer(self, result)
  local frame, transfer, item, fields = result.frame, result.transfer, self.item, self.fields
  if #transfer > 1 then
    local payload = self.payload_tvb and self.payload_tvb()
    set_generated(add(item, fields["reassembled.in"], frame.number))
    append_text(set_generated(add(item, fields.size, transfer.size)), " bytes")
    set_generated(add(item, fields.reserved, transfer.reserved or 0))
    local crc = transfer.crc or can_id.crc(frame.can_id, transfer.payload)
    self.builder:add_crc(item, nil, transfer, crc)
    self.builder:add_fragments(item, payload or self.range, transfer, #transfer.payload, payload)
  end
  local start = frame.reported - (transfer.padding or 0)
  if start < #frame.data then add(item, fields.padding, self.tvb(start)) end
end

-- By kind of result: functions that return the text of the Info column ----------------------------

-- Return a Tvb with the payload of a transfer, false for none.
local function payload_tvb_of(self, transfer)
  if #transfer == 1 then return self.tvb end
  return transfer.payload ~= "" and ByteArray.new(transfer.payload, true):tvb("Reassembled YAPP")
end

-- Show the frame that has a whole message, or its last fragment, and the message.
local function show_last(self, result)
  local builder, wants, message = self.builder, self.wants, result.message
  local transfer = result.transfer
  local status = transfer.status
  self.payload_tvb = wants.tree and payload_tvb_of(self, transfer)
  if wants.yapp then add_transfer(self, result) end
  if status == "bad" then builder:bad_crc(self.item, transfer) end
  local mark = #transfer > 1 and builder.MARKS[status] or ""
  if not transfer.received then return builder:show_message(message, self) .. mark end
  if wants.yapp then
    if self.payload_tvb then add(self.item, self.fields.payload, self.payload_tvb()) end
    builder:add_delta(self.item, message)
  end
  local text = "%s  %d of %d bytes%s"
  return text:format(message.source.label, transfer.received, transfer.size, mark)
end

-- Return the text of a fragment.  A good transfer has a known number of fragments; for another one
-- assume the number that classic CAN needs.  The source caches the texts for transfers of one size
-- and number of fragments.
local function fragment_text(result)
  local frame, transfer = result.frame, result.transfer
  local source, index, size, count = frame.source, result.index or #transfer, transfer.size, 0
  if transfer.status == "good" then
    count = #transfer
  elseif #frame.data == 8 then
    count = math.ceil(size / 8) + 1
  end
  if transfer[index] ~= frame.key then return source.label .. "  duplicate fragment" end
  local texts = source.texts
  if texts.size ~= size or texts.count ~= count then
    texts = { ("%s  Start of %d bytes"):format(source.short, size), size = size, count = count }
    source.texts = texts
  end
  if not texts[index] then
    local text = index > count and "%s  fragment %d" or "%s  fragment %d of %d"
    texts[index] = text:format(source.short, index, count)
  end
  return texts[index]
end

local function show_fragment(self, result)
  local frame, transfer, item, in_number = result.frame, result.transfer, self.item, nil
  local last, wants = transfer[#transfer], self.wants
  if frame.visited then
    if transfer.payload then
      in_number = last % 1 == 0 and number_of(last)
    elseif not transfer.status and last == frame.key then
      self.builder:expert(item, "unfinished")
    end
  end
  if wants.yapp then
    add_fragment(self, result)
    if in_number then set_generated(add(item, self.fields["reassembled.in"], in_number)) end
    self.builder:add_has_fault(item, transfer.has_fault)
  end
  if not wants.columns then return end
  local text = fragment_text(result)
  return in_number and ("%s  [Reassembled in #%d]"):format(text, in_number) or text
end

-- A frame that belongs to no transfer.
local function show_other(self, result)
  local ctrl, name = result.frame.can_id.ctrl, result.frame.source.label
  if self.wants.yapp then add_fragment(self, result) end
  if not CTRL_NAMES[ctrl] then return ("%s  CAN CTRL %d"):format(name, ctrl) end
  local text = ("%s  %s"):format(name, CTRL_NAMES[ctrl])
  return ctrl ~= START and text .. " without a Start" or text
end

local SHOW = {
  single = show_last, last = show_last, fragment = show_fragment, other = show_other,
}

-- Frames ------------------------------------------------------------------------------------------

local function show_anomalies(self, frame, anomalies)
  local builder, item = self.builder, self.item
  if #frame.data < frame.reported then
    local text = "The capture has %d of the frame's %d bytes"
    builder:expert(item, "truncated", text:format(#frame.data, frame.reported))
  end
  for _, one in ipairs(anomalies or {}) do builder:expert(item, one.expert, one.text) end
end

--- Show a frame.
-- result  of the reading
-- wants   of Tree:wants
-- tree    nil in a tap, which has none
function FrameView:show(result, wants, tvb, pinfo, tree)
  local frame, kind = result.frame, result.kind
  self.tvb, self.tree, self.item, self.wants = tvb, tree, tree, wants
  if wants.yapp then
    self.item = add_item(self, frame)
  elseif wants.names then
    self.builder:add_protocol_names(tree, wants, result.message)
  end
  local info = SHOW[kind](self, result)
  if result.anomalies or #frame.data < frame.reported then
    show_anomalies(self, frame, result.anomalies)
  end
  if not wants.columns then return end
  local columns = pinfo.cols
  columns.protocol = "YAPP"
  columns.src = frame.source.text
  columns.info = info
end

--- Show as bytes a frame that the user calls YAPP, but whose CAN id is not known.  That is the
-- first frame of Decode As, on a pass that builds no tree.
function FrameView:show_without_id(wants, tvb, pinfo, tree)
  local builder, item = self.builder, tree
  if wants.yapp then
    item = add(tree, builder.yapp, tvb())
    if tvb:len() > 0 then add(item, self.fields.payload, tvb()) end
  end
  pinfo.cols.protocol = "YAPP"
  builder:expert(item, "can.id.missing")
end

return M
]=])
module("yapp.show.packet", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The view of a packet of a byte stream or datagram: its frames, the bytes of no frame, and the
-- bytes that wait for more.  Wireshark's API.

local frame = require "yapp.wire.frame"
local frame_key = require "yapp.base.frame_key"
local show_fields = require "yapp.show.fields"
local utf8 = require "yapp.base.utf8"

local M = {}

local sub = string.sub
local add, add_le = show_fields.add, show_fields.add_le
local append_text, set_generated = show_fields.append_text, show_fields.set_generated
local HEADER, CRC_SIZE = frame.HEADER, frame.CRC_SIZE
local MAX_IN_INFO = 10 -- frames of a packet

local PacketView = {}
PacketView.__index = PacketView

--- Make the view of packets.
-- builder  a show.tree
function M.new(builder)
  return setmetatable({ builder = builder, fields = builder.fields }, PacketView)
end

-- Messages ----------------------------------------------------------------------------------------

-- Add YAPP's own item of a frame; return it.
-- tvb  where the bytes of the frame are
local function add_item(self, result, tvb, tree)
  local builder, fields, transfer = self.builder, self.fields, result.transfer
  local source, offset, payload = result.frame.source, transfer.offset, transfer.payload
  local item = add(tree, builder.yapp, tvb(offset, transfer.length))
  append_text(item, (", %s"):format(source.short))
  add(item, fields.sync, tvb(offset, 2))
  add(item, fields.seq, tvb(offset + 2, 1))
  add(item, fields.ctl, tvb(offset + 3, 1))
  builder:add_id(item, tvb(offset + 4, 4), source)
  append_text(add_le(item, fields.size, tvb(offset + 8, 2)), " bytes")
  add_le(item, fields.reserved, tvb(offset + 10, 2))
  builder:add_source(item, source)
  if transfer.packet_keys then
    local range = #payload > 0 and tvb(offset + HEADER, #payload) or nil
    set_generated(add(item, fields["reassembled.in"], result.frame.number))
    builder:add_fragments(item, tvb(), transfer.packet_keys, transfer.length, range)
  end
  if transfer.missing then
    append_text(item, ", incomplete")
  else
    builder:add_crc(item, tvb(offset + HEADER + transfer.size, CRC_SIZE), transfer)
  end
  return item
end

-- Show a message; return its text for the Info column.
local function show_message(self, result, tvb, wants, tree)
  local builder, transfer, message = self.builder, result.transfer, result.message
  local status, source = transfer.status, message.source
  local offset = transfer.offset + HEADER
  local item = wants.tree and add_item(self, result, tvb, tree) or tree
  if status == "bad" then builder:bad_crc(item, transfer) end
  for _, one in ipairs(result.anomalies or {}) do builder:expert(item, one.expert, one.text) end
  local mark = builder.MARKS[status]
  if status ~= "incomplete" or not source.message then
    return builder:show_message(message, {
      wants = wants,
      tree = tree,
      item = item,
      payload_tvb = wants.tree and tvb,
      payload_offset = offset,
    }) .. mark
  end
  if wants.yapp and #message.payload > 0 then
    add(item, self.fields.payload, tvb(offset, #message.payload))
  end
  return source.label .. mark
end

-- Bytes of no frame ------------------------------------------------------------------------------

-- Control characters of a terminal, and how they are shown.
local CONTROLS = {
  ["\a"] = "\\a",
  ["\b"] = "\\b",
  ["\t"] = "\\t",
  ["\n"] = "\\n",
  ["\r"] = "\\r",
  ["\27"] = "\\e",
}

-- Return a space and bytes as quoted text, "" if they are no text.
local function quote(bytes)
  if utf8.ascii(bytes):find("[^%g \a\b\t\n\r\27]") then return "" end
  local text = bytes
  if #bytes > 80 then
    text = bytes:sub(1, 80):gsub("[\192-\255][\128-\191]*$", "") .. "..."
  end
  return ' "' .. text:gsub("%c", CONTROLS) .. '"'
end

-- Show skipped bytes; return their text for the Info column.
local function show_skipped(self, result, packet, tvb, wants, item)
  local builder, length, finding = self.builder, result.length, result.transfer
  local offset = finding.offset or 0
  local text = quote(finding.bytes or sub(packet.bytes, offset + 1, offset + length))
  local size = builder.bytes(length)
  if wants.tree then
    item = add(item, builder.yapp, tvb(offset, length))
    append_text(item, (", %s skipped"):format(size))
    append_text(add(item, self.fields.skipped, tvb(offset, length)), text)
  end
  local expert = size .. " that belong to no frame" .. text:gsub("^ ", ": ")
  builder:expert(item, "stream.skipped", expert)
  return ("Skipped %s%s"):format(size, text)
end

-- Return the text of the Info column about pending bytes.
local function pending_text(contents, size, leads_to)
  if leads_to then return ("[Reassembled in #%d]"):format(leads_to) end
  if contents.is_held then return ("[%s behind a missing TCP segment]"):format(size) end
  if contents.missing then return ("[%s of a frame, %d to come]"):format(size, contents.missing) end
  return ("[%s wait for more]"):format(size)
end

-- Show the pending bytes of a packet; return their text for the Info column.
local function show_pending(self, packet, contents, tvb, wants, item)
  local builder, fields, pending = self.builder, self.fields, contents.pending
  local leads_to = contents.leads_to and frame_key.number(contents.leads_to)
  if wants.tree then
    local range = tvb(#packet.bytes - pending, pending)
    item = add(item, builder.yapp, range)
    append_text(item, ", part of a frame")
    add(item, fields["fragment.data"], range)
    if leads_to then set_generated(add(item, fields["reassembled.in"], leads_to)) end
  end
  if contents.is_unfinished then builder:expert(item, "unfinished") end
  return pending_text(contents, builder.bytes(pending), leads_to)
end

-- Packets -----------------------------------------------------------------------------------------

-- Show a result; return its text for the Info column.
local function show_result(self, result, packet, tvb, wants, tree)
  local bytes = result.transfer.bytes
  if bytes and wants.tree then tvb = ByteArray.new(bytes, true):tvb("Reassembled YAPP") end
  if result.message then return show_message(self, result, tvb, wants, tree) end
  return show_skipped(self, result, packet, tvb, wants, tree)
end

-- Say that the capture has not all bytes of a packet, if no frame of it says so.
local function show_truncated(self, packet, results, tree)
  local last = results[#results]
  if packet.bytes == "" or last and last.transfer.missing then return end
  local text = "The capture has %d of the packet's %d bytes"
  self.builder:expert(tree, "truncated", text:format(#packet.bytes, packet.length))
end

-- Fill the columns.
-- texts   of the Info column; source = text of the first source, or nil
local function show_columns(packet, texts, source, columns)
  columns.protocol, columns.info = "YAPP", table.concat(texts, " | ")
  if source and not packet.line.has_address then columns.src = source end
end

--- Show the contents of a packet.
-- packet    see host.serial
-- contents  of Reading:add_packet
-- wants     of Tree:wants
-- tvb       where its bytes are, if a tree is wanted
function PacketView:show(packet, contents, wants, tvb, pinfo, tree)
  local texts, source, results = {}, nil, contents.results
  if wants.names and not wants.tree then self.builder:add_protocol_names(tree, wants, true) end
  for i, result in ipairs(results) do
    local text = show_result(self, result, packet, tvb, wants, tree)
    source = source or result.message and result.frame.source.text
    if i <= MAX_IN_INFO then texts[i] = text end
  end
  local more = #results - MAX_IN_INFO
  if more > 0 then texts[#texts + 1] = ("and %d more"):format(more) end
  if contents.pending > 0 then
    texts[#texts + 1] = show_pending(self, packet, contents, tvb, wants, tree)
  end
  if wants.columns and texts[1] then show_columns(packet, texts, source, pinfo.cols) end
  if packet.truncated then show_truncated(self, packet, results, tree) end
end

return M
]=])
module("yapp.show.packet_menu", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The submenu YAPP in the menu of a packet, from Wireshark 4.4 on, and an entry of Tools > YAPP.
-- Wireshark's API.

local source_names = require "yapp.message.sources"

local M = {}

local EXTENDED, REMOTE, ID_END = 0x80000000, 0x40000000, 0x20000000 -- in the word that has the id

-- Stands for a message with fault flags: neither an unknown ID nor another message has some.
local HAS_FAULTS = {}
local FAULTS = "yapp.source in {%s} && (taurus.fault.raised || taurus.fault.cleared)"
-- Title, a field that the packet must have, and the display filter that its values and the packet's
-- number make.  Wireshark selects the packet that is nearest to the one that was.
local FILTERS = {
  { "Only this controller", "yapp.source", "yapp.source in {%s}" },
  { "Faults of this controller", HAS_FAULTS, FAULTS },
  { "Previous fault of this controller", HAS_FAULTS, FAULTS .. " && frame.number < %d" },
  { "Next fault of this controller", HAS_FAULTS, FAULTS .. " && frame.number > %d" },
  { "Whole message", "yapp.reassembled.in", "yapp.reassembled.in in {%s}" },
}

-- Add an item.
-- name  of a field that the packet must have
-- act   function(values): by name those of YAPP's fields, and of frame.number, as a display filter
--       writes them, with commas between
local function add(title, name, act)
  register_packet_menu("YAPP/" .. title, function(...)
    local values = {}
    for _, field in ipairs { ... } do
      local key = field.name
      if key:find("^yapp%.") or key == "frame.number" then
        local value = field.value
        if type(value) == "string" then value = '"' .. value:gsub('[\\"]', "\\%0") .. '"' end
        values[key] = (values[key] and values[key] .. "," or "") .. tostring(value)
      end
    end
    act(values)
  end, name)
end

-- Set preferences: { [name without "yapp."] = value }.
local function set(values)
  for name, value in pairs(values) do set_preference("yapp." .. name, value) end
  apply_preferences()
  redissect_packets()
end

-- Return the bus of a packet; nil without one.
local function bus_of(values)
  local bus = (values["yapp.bus"] or ""):match('^"(.-[^\\])"')
  return bus and bus:gsub("\\(.)", "%1")
end

-- Return the id and the data of a frame as `candump -l` writes them.
-- at  offset of the SocketCAN header: id and flags, length, flags of CAN FD, two bytes, data
local function candump_text(tvb, at, id)
  local word = tvb(at, 4):uint()
  if word % ID_END ~= id then word = tvb(at, 4):le_uint() end -- as a cooked capture has it
  local length, flags = tvb(at + 4, 1):uint(), tvb(at + 5, 1):uint()
  local text = (word >= EXTENDED and "%08X#" or "%03X#"):format(id)
  if word % EXTENDED >= REMOTE then return text .. "R" .. (length > 0 and length or "") end
  local fd = (length > 8 or flags > 3) and "#" .. flags % 4 or ""
  return text .. fd .. tostring(tvb(at + 8, length):bytes())
end

-- Copy the frames of a message as `candump -l` writes them.
local function copy_as_candump(values)
  local bus, lines = bus_of(values) or "can0", {}
  local tap = Listener.new("frame", "can.id && (frame.number == " .. values["frame.number"] ..
    " || yapp.reassembled.in == " .. (values["yapp.reassembled.in"] or 0) .. ")")
  function tap.packet(pinfo, tvb)
    for _, info in ipairs { all_field_infos() } do
      if info.name == "can.id" then
        local text = candump_text(tvb, info.offset, info.value)
        lines[#lines + 1] = ("(%.6f) %s %s\n"):format(pinfo.abs_ts, bus, text)
      end
    end
  end
  retap_packets()
  tap:remove()
  copy_to_clipboard(table.concat(lines))
end

-- Ask for a name, in the text of the whole preference, which can be changed.
local function ask_name(values, sources, catalogue)
  local bus, id = bus_of(values), tonumber(values["yapp.id"]:match("%d+"))
  if not source_names.parse(sources, catalogue):has_part(bus, id) then
    sources = sources .. (sources == "" and "" or ", ") .. source_names.address(bus, id) .. "="
  end
  new_dialog("YAPP Name this controller", function(answer)
    if not answer:find("=%s*$") then set { sources = answer } end
  end, { name = "Names of sources", value = sources })
end

-- Return all unknown IDs of the capture that have the size of a message: { [message] = list }.
local function find_ids(messages)
  local found, by_field, fields = {}, {}, {}
  for _, message in ipairs(messages) do
    local field = "yapp.like." .. message.name
    by_field[field], fields[#fields + 1] = message, field
  end
  local tap = Listener.new("frame", table.concat(fields, " || "))
  function tap.packet()
    for _, info in ipairs { all_field_infos() } do
      local message = by_field[info.name]
      if message then
        found[message] = found[message] or {}
        found[message][info.value] = true
      end
    end
  end
  retap_packets()
  tap:remove()
  for message, is_known in pairs(found) do
    found[message] = {}
    for id in pairs(is_known) do table.insert(found[message], id) end
    table.sort(found[message])
  end
  return found
end

-- Decode all unknown IDs of the capture that have the size of a message as that message.
local function decode_by_size(prefs, messages)
  local values = {}
  for message, ids in pairs(find_ids(messages)) do
    local name = message.name .. "_ids"
    values[name] = prefs[name] .. "," .. table.concat(ids, ",")
  end
  if next(values) then return set(values) end
  report_failure("YAPP: no message of an unknown ID has the size of a message in the catalogue")
end

-- Add an item that filters.
-- row  of FILTERS; field: that the packet must have; of: whose values are in the filter
local function add_filter(row, field, of)
  add(row[1], field, function(values)
    set_filter(row[3]:format(values[of], values["frame.number"]))
    apply_filter()
  end)
end

-- COMPAT 4.0: no register_packet_menu.
local function register_of_packet(prefs, catalogue)
  for _, row in ipairs(FILTERS) do
    if row[2] == HAS_FAULTS then
      for _, message in ipairs(catalogue.messages) do
        local field = message.fault_field or message.alarms[1]
        if field then add_filter(row, field.filter, "yapp.source") end
      end
    else
      add_filter(row, row[2], row[2])
    end
  end
  for _, message in ipairs(catalogue.messages) do
    local ids, like = message.name .. "_ids", "yapp.like." .. message.name
    add("Decode this ID as " .. message.title, like, function(values)
      set { [ids] = prefs[ids] .. "," .. values[like] }
    end)
    add("Decode all IDs of this size as " .. message.title, like, function()
      decode_by_size(prefs, { message })
    end)
  end
  add("Name this controller ...", "yapp.id", function(values)
    ask_name(values, prefs.sources, catalogue)
  end)
  add("Copy message as candump", "can.id", copy_as_candump)
end

--- Make the menus.
-- prefs      of yapp
-- catalogue  compiled
function M.register(prefs, catalogue)
  if register_packet_menu then register_of_packet(prefs, catalogue) end
  register_menu("YAPP/Decode unknown IDs by size", function()
    decode_by_size(prefs, catalogue.messages)
  end, MENU_TOOLS_UNSORTED)
end

return M
]=])
module("yapp.show.taurus", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The view of the Taurus messages: their trees and expert items.  Wireshark's API; the values come
-- from message.field_kinds, the changes from the history.

local binary = require "yapp.message.binary"
local band = require "yapp.base.bits".band
local field_kinds = require "yapp.message.field_kinds"
local frame_key = require "yapp.base.frame_key"
local show_fields = require "yapp.show.fields"
local text_of = require "yapp.message.text"

local M = {}

local add = show_fields.add
local add_expert = show_fields.add_expert
local set_generated = show_fields.set_generated
local add_le = show_fields.add_le
local append_text = show_fields.append_text
local fault_names, flag_names = text_of.fault_names, text_of.flag_names
local value_of = field_kinds.value
local format = string.format
local range_of = Tvb.range
local referenced = TreeItem.referenced
local set_hidden = TreeItem.set_hidden
local set_text = TreeItem.set_text

local NONE = {}

local Taurus = {}
Taurus.__index = Taurus

--- Make the view of values.
-- taurus    Proto
-- messages  of the catalogue
-- fields    of show.fields
function M.new(taurus, messages, fields)
  return setmetatable({
    taurus = taurus,
    messages = messages,
    fields = fields,
  }, Taurus)
end

-- Adding a field ----------------------------------------------------------------------------------

-- How a field is added, by `shown` of its kind, see message.field_kinds: function(field, fields),
-- which returns a function(parent, range, raw) -> item.
-- fields  { [filter] = ProtoField }: of flags those that are wanted
local ADD = {}

local function append_unit(item, field)
  return field.unit and append_text(item, " " .. field.unit) or item
end

-- A field whose bytes Wireshark reads itself.
function ADD.plain(field, fields)
  local pf = fields[field.filter]
  return function(parent, range)
    return append_unit(add_le(parent, pf, range), field)
  end
end

-- A number with a fraction, or the special that is there instead.
function ADD.number(field, fields)
  local pf, special_pf = fields[field.filter], fields[field.special]
  local label, unit = (field.array or field).title .. ": ", field.unit and " " .. field.unit or ""
  local bytes, write = " (0x%0" .. field.size * 2 .. "x)", field_kinds.new_number_text(field)
  return function(parent, range, raw)
    local text, special = write(raw)
    if text then return add(parent, pf, range, tonumber(text), label .. text .. unit) end
    text = label .. field_kinds.SPECIALS[special]
    if field.kind == "float" and raw >= 0 then text = text .. format(bytes, raw) end
    return set_text(add(parent, special_pf, range, special), text)
  end
end

function ADD.text(field, fields)
  local pf = fields[field.filter]
  return function(parent, range, raw)
    return add(parent, pf, range, value_of(field, raw))
  end
end

function ADD.time(field, fields)
  local pf = fields[field.filter]
  return function(parent, range, raw)
    return add(parent, pf, range, NSTime.new(binary.time(raw, 0)))
  end
end

-- Return a function(raw) -> the ProtoFields of flags, those that are set first: of thirty faults
-- the one that is there is seen at once.  It keeps the latest order.
-- flags  { { pf, mask }, ... }
local function ordered(flags)
  local order, latest = {}, nil
  return function(raw)
    if raw == latest then return order end
    local unset = {}
    order, latest = {}, raw
    for _, flag in ipairs(flags) do
      local list = band(raw, flag[2]) ~= 0 and order or unset
      list[#list + 1] = flag[1]
    end
    for _, pf in ipairs(unset) do order[#order + 1] = pf end
    return order
  end
end

-- Flags, with those of their ProtoFields that are wanted.
function ADD.flags(field, fields)
  local pf, names_pf = fields[field.filter], fields[field.filter .. ".names"]
  local undefined_pf, flags = fields[field.group .. ".undefined"], {}
  for _, flag in ipairs(field.flags) do
    local own = fields[flag.filter]
    if own then flags[#flags + 1] = { own, flag.mask } end
  end
  local order_of = ordered(flags)
  return function(parent, range, raw)
    local item = pf and add_le(parent, pf, range) or parent
    local order = order_of(raw)
    for i = 1, #order do add_le(item, order[i], range) end
    if raw == 0 then return item end
    local undefined, names = band(raw, field.undefined), flag_names(field, raw)
    if undefined_pf and undefined ~= 0 then add(item, undefined_pf, range, undefined) end
    if names == "" then return item end
    if pf then append_text(item, " (" .. names .. ")") end
    if names_pf then set_hidden(set_generated(add(item, names_pf, names))) end
    return item
  end
end

-- What is wanted ----------------------------------------------------------------------------------

-- Return the ProtoFields that a tree wants, by filter; nil for none.
local function wanted_of(self, tree, filters)
  local wanted = {}
  for _, filter in pairs(filters) do
    local pf = self.fields[filter]
    if referenced(tree, pf) then wanted[filter] = pf end
  end
  return next(wanted) and wanted
end

-- The parts of a state of message.history, in the order of the tree: name, form, and whether it is
-- about faults.
local STATES = {
  { "raised_in", frame_key.number, true },
  { "cleared_in", frame_key.number, true },
  { "previous_change", frame_key.number, true },
  { "next_change", frame_key.number, true },
  { "active_time", show_fields.relative_time, true },
  { "drift", show_fields.relative_time, false },
  { "command_in", frame_key.number, false },
}

--- Return whether a tree wants a field that comes from the history's state, which each message has.
function Taurus:wants_state(tree)
  for _, message in ipairs(self.messages) do
    if wanted_of(self, tree, message.states) then return true end
  end
  return false
end

-- Add to a plan which names of faults and states are wanted.
local function add_state_steps(self, message, tree, plan)
  for _, row in ipairs(STATES) do
    local pf = self.fields[message.states[row[1]]]
    if pf and referenced(tree, pf) then
      table.insert(plan.states, { name = row[1], show = row[2], is_fault = row[3], pf = pf })
    end
  end
  local pf = self.fields[message.fault_names]
  plan.names = pf and referenced(tree, pf) and pf
end

-- Return how the tree of a message is built: a list of steps { field, index, parent = index of the
-- field that it is a part of, add = see ADD }; own = whether the message's field is wanted; and of
-- what is wanted: generated, rounded, states = lists; names = ProtoField of the names of faults.
local function make_plan(self, message, tree)
  local plan, fields = { generated = {}, rounded = {}, states = {} }, self.fields
  plan.own = referenced(tree, fields[message.filter])
  for index, field in ipairs(message.fields) do
    local wanted = wanted_of(self, tree, field.filters)
    if wanted then
      plan[#plan + 1] = {
        field = field,
        index = index,
        parent = field.inside and field.inside.index,
        add = ADD[field_kinds.BY_NAME[field.kind].shown](field, field.flags and wanted or fields),
      }
    end
  end
  for _, item in ipairs(message.generated) do
    local pf = fields[item.filter]
    if referenced(tree, pf) then
      local write = field_kinds.new_number_text(item)
      table.insert(plan.generated, { item = item, pf = pf, write = write })
    end
  end
  -- Values for columns are not among the details.
  for _, step in ipairs(tree.visible and NONE or message.rounded) do
    if referenced(tree, fields[step.filter]) then table.insert(plan.rounded, step) end
  end
  add_state_steps(self, message, tree, plan)
  return plan
end

-- Return the plan for a tree.  In tshark's first pass it is kept in what is wanted, which holds for
-- all packets: without plans a filter for one fault takes 1.9 times as long.
local function plan_of(self, message, view)
  local plans = view.wants.plans or {}
  plans[message] = plans[message] or make_plan(self, message, view.tree)
  return plans[message]
end

-- The tree of a message ---------------------------------------------------------------------------

-- Return the text of an element of an array, whose item begins with the array's title.  In a tree
-- that is not shown, an item has no text.
local function element_text(item, field)
  return field.title .. (item.text or ""):sub(#field.array.title + 1)
end

-- Add the names of the faults among a field's flags to a list.
local function list_faults(names, field, raw)
  local faults = fault_names(field, raw)
  if faults ~= "" then names[#names + 1] = faults end
end

-- Return the names of the faults that are set in a message: "motor_overcurrent, faulted", "" for
-- none.
local function active_faults(message)
  local names = {}
  for _, field in ipairs(message.source.message.alarms) do
    list_faults(names, field, message.raws[field.index])
  end
  return table.concat(names, ", ")
end

-- Return the names of the faults that changed.
-- changes  of message.history
-- way      "raised" or "cleared"
local function changed_faults(changes, way)
  local names = {}
  for _, one in ipairs(changes) do list_faults(names, one.field, one[way]) end
  return table.concat(names, ", ")
end

-- Return the change of the faults here: ", raised here" if that is all that are set,
-- "; hall_timeout raised here; motor_overcurrent cleared here", "" for nothing.
local function changes_text(message, active)
  local text = ""
  for _, way in ipairs { "raised", "cleared" } do
    local names = changed_faults(message.change and message.change.flags or NONE, way)
    if names ~= "" then
      text = text .. (names == active and ", " or "; " .. names .. " ") .. way .. " here"
    end
  end
  return text
end

-- Add states.
-- is_fault  whether those about faults, or the others
local function add_states(message, plan, item, is_fault)
  for _, step in ipairs(message.state and plan.states or NONE) do
    local value = step.is_fault == is_fault and message.state[step.name]
    if value then set_generated(add(item, step.pf, step.show(value))) end
  end
end

-- Add what is wrong, which stands above the values, with links to where it began and ended:
-- "[Faults: motor_overcurrent, raised here]".
-- returns  its item, nil for none
local function add_faults(message, plan, tree, top)
  local item
  local is_change = message.change and message.change.flags and tree.visible
  if plan.names and (message.has_fault or is_change) then
    local active = active_faults(message)
    local here = changes_text(message, active)
    if here == "" and message.state and message.state.active_time then
      here = (", for %.3f s"):format(message.state.active_time)
    end
    if active ~= "" then
      item = append_text(set_generated(add(top, plan.names, active)), here)
    elseif here ~= "" then
      item = set_generated(add(top, "Faults: none" .. here))
    end
  end
  add_states(message, plan, item or top, true)
  return item
end

-- Add the values that are worked out from others.
local function add_generated_values(self, message, plan, top)
  local raws, fields = message.raws, self.fields
  for _, step in ipairs(plan.generated) do
    local text = step.write(raws)
    if text then append_unit(set_generated(add(top, step.pf, tonumber(text))), step.item) end
  end
  for _, step in ipairs(plan.rounded) do
    local field, raw = step.field, raws
    if field.index then raw = raws[field.index] end
    local value = value_of(field, raw)
    -- Adding 0 makes -0 a 0.
    if value then set_generated(add(top, fields[step.filter], step.shape:format(value) + 0)) end
  end
end

-- Build it; return it, the items by index of field, for the expert items, and the one of faults.
local function build(self, message, view)
  local raws, items, of_type = message.raws, {}, message.source.message
  local plan, tvb, offset = plan_of(self, of_type, view), view.payload_tvb, view.payload_offset
  local whole = range_of(tvb, offset, math.min(of_type.size, #message.payload))
  local top = add(view.tree, self.taurus, whole, "Taurus " .. of_type.title)
  if plan.own then set_hidden(add(top, self.fields[of_type.filter], whole)) end
  local above = add_faults(message, plan, view.tree, top)
  for i = 1, #plan do
    local step = plan[i]
    local field, index = step.field, step.index
    local raw = raws[index]
    if raw then
      local range = range_of(tvb, offset + field.offset, field.size)
      local item = step.add(items[step.parent] or top, range, raw)
      if field.array then set_text(item, element_text(item, field)) end
      items[index] = item
    end
  end
  add_generated_values(self, message, plan, top)
  add_states(message, plan, top, false)
  return top, items, above
end

-- Append the catalogue's help on the flags that are set.
local function append_help(item, field, raw)
  for _, flag in ipairs(field.flags) do
    if flag.help and band(raw, flag.mask) ~= 0 then
      append_text(item, ("; %s: %s"):format(flag.name, flag.help))
    end
  end
end

--- Show a message, and its expert items.
-- message, view  as Tree:show_message takes them
-- returns  the Taurus item, and the item of its faults; nil without a tree
function Taurus:show(message, view)
  local top, items, above = nil, NONE, nil
  if view.payload_tvb and message.payload ~= "" then
    top, items, above = build(self, message, view)
  end
  for _, remark in ipairs(message.remarks or NONE) do
    local index, name = remark[1], remark[2]
    local item = items[index]
    if name ~= "fault.active" then
      add_expert(item or top or view.item, "taurus." .. name)
    elseif item then
      append_help(item, message.source.message.fields[index], message.raws[index])
    end
  end
  if message.has_fault then add_expert(above or top or view.item, "taurus.fault.active") end
  return top, above
end

-- Changes -----------------------------------------------------------------------------------------

-- Add the bits of flags fields that rose or fell, and one expert item if faults are among them.
-- way      "raised" or "cleared"
-- top      nil without a tree
-- item     for the expert item
-- returns  the names of those faults, "" for none
local function add_flags_changes(self, changes, way, top, item)
  for _, one in ipairs(top and changes or NONE) do
    local field, raw = one.field, one[way]
    local pf = self.fields[field.group .. "." .. way]
    if raw ~= 0 and referenced(top, pf) then
      local added = set_generated(add(top, pf, raw))
      append_text(added, " (" .. flag_names(field, raw) .. ")")
      if way == "raised" then append_help(added, field, band(raw, field.alarm_bits)) end
    end
  end
  local faults = changed_faults(changes, way)
  if faults ~= "" then add_expert(item, "taurus.fault." .. way) end
  return faults
end

--- Add the history of a message, all of it generated, with its expert items.
-- message  of reading.messages
-- top      the Taurus item; nil if no tree is wanted: then add expert items only
-- other    the item for these if top is nil
-- above    the item of its faults, nil for none
-- returns  what the Info column begins and ends with because of it:
--          "cleared motor_overcurrent, hall_timeout  ", "  REBOOT"
function Taurus:add_change(message, top, other, above)
  local change, item, info, cleared = message.change, top or other, "", ""
  if change.flags then
    add_flags_changes(self, change.flags, "raised", top, above or item)
    cleared = add_flags_changes(self, change.flags, "cleared", top, above or item)
    if cleared ~= "" then cleared = "cleared " .. cleared .. "  " end
  end
  for _, row in ipairs(show_fields.CHANGES) do
    local value, label, word = change[row.change], row.label, row.word
    if value then
      add_expert(item, row[1], label and label:format(value))
      if word then info = info .. "  " .. word end
    end
  end
  return cleared, info
end

return M
]=])
module("yapp.show.tree", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The view of YAPP's messages, however they came: parts of the tree, expert items, the Info column.
-- show.frame and show.packet show their frames and packets, show.taurus their values.
-- Wireshark's API.

local show_fields = require "yapp.show.fields"
local text_of = require "yapp.message.text"
local messages_of = require "yapp.show.taurus"
local number_of = require "yapp.base.frame_key".number

local M = {}

local add = show_fields.add
local set_generated = show_fields.set_generated
local append_text = show_fields.append_text

-- By status: crc.status, the text behind the CRC, and the text of the item.
local CRC = {
  bad = { 0, " [incorrect, should be 0x%08x]", ", CRC BAD" },
  good = { 1, " [correct]", ", CRC good" },
}
local UNVERIFIED = { 2, " [unverified]", ", CRC unverified" }

local Tree = {}
Tree.__index = Tree

--- The last word in Info, by the status of the message.
Tree.MARKS = {
  good = "",
  bad = "  [BAD CRC]",
  incomplete = "  [INCOMPLETE]",
  overrun = "  [OVERRUN]",
  truncated = "  [TRUNCATED]",
}

--- Make the view of messages.
-- options  { yapp =, taurus = Proto, catalogue = compiled, reading = a reading.reading;
--          fields, taurus_fields = of the two, see show.fields; names = { [id] = title } }
function M.new(options)
  return setmetatable({
    yapp = options.yapp,
    taurus = options.taurus,
    reading = options.reading,
    messages = messages_of.new(options.taurus, options.catalogue.messages, options.taurus_fields),
    fields = options.fields,
    default_names = options.names, -- by ID
    wanted = nil, -- of Tree:wants, in the first pass of tshark
    is_only_pass = false, -- whether it is known that there is one pass
  }, Tree)
end

--- Forget what was wanted of the file before.
function Tree:reset()
  self.wanted, self.is_only_pass = nil, false
end

--- Say that this first pass of tshark is its only one: no packet is revisited.
function Tree:only_pass()
  self.wanted, self.is_only_pass = nil, true
end

-- What is wanted ----------------------------------------------------------------------------------

-- Despite its name, tree.hidden says whether there is a tree at all, shown or not.
local IS_TSHARK = not gui_enabled()
local NO_COLUMN = "(info)" -- the text of a column if there are no columns
local SAYS_PROTOCOLS = not get_version():find("^4%.[0-5]%.")
-- COMPAT 4.0: no filter can name a column there.
local FILTERS_COLUMNS = not get_version():find("^4%.0%.")

-- Return whether tshark's first pass is its only one.  The first pass of two shows no tree.  It has
-- columns only if a filter names a column, and then it builds a tree.
local function is_only_pass(tree, has_columns)
  if not tree.hidden then return has_columns end
  return tree.visible or has_columns and not (FILTERS_COLUMNS and pcall(all_field_infos))
end

local LIST = { columns = true, shows = true } -- a packet list of Wireshark, or of later passes

-- Ask Wireshark which parts of a packet are wanted.
local function ask(self, tree)
  -- The API takes a dissector here, and ours exist only after loading.
  local wants = { columns = true, shows = true }
  wants.yapp = tree:referenced(Dissector.get("yapp"))
  wants.taurus = tree:referenced(Dissector.get("taurus"))
  wants.tree = wants.yapp or wants.taurus
  wants.state = wants.taurus
  wants.names = not SAYS_PROTOCOLS and not self.reading.listener
  return wants
end

-- Ask Wireshark in tshark's first pass, where the answer is the same for all packets.
local function ask_first(self, tree, pinfo)
  local has_columns = tostring(pinfo.cols.info) ~= NO_COLUMN
  local wants = tree.hidden and ask(self, tree) or {}
  wants.columns = has_columns
  wants.shows = has_columns or wants.tree or wants.names
  wants.plans = {}
  wants.is_only_pass = self.is_only_pass or is_only_pass(tree, has_columns)
  wants.state = wants.taurus and self.messages:wants_state(tree)
  return wants
end

--- Return which parts of a packet are wanted.
-- visited   whether the packet was shown before
-- returns   {
--   yapp          whether YAPP's own items are shown, filtered or printed
--   taurus        whether those of messages are
--   tree          whether one of the two is
--   state         whether the state of messages that change nothing is wanted, too
--   names         whether the names of the protocols are wanted although the above are not, see
--                 Tree:add_protocol_names
--   shows         whether anything but expert items is wanted
--   columns       whether there are columns: tshark has them for a packet list, and not with -V,
--                 -q, most of -T or in a first pass of two
--   plans         see show.taurus, nil where the answer may change
--   is_only_pass  whether it is sure that no packet is shown again, so that nothing need be kept: a
--                 tenth of a packet list }
-- In tshark's first pass the answer is the same for all packets, so it is asked once; in Wireshark,
-- and in later passes, it may change.
function Tree:wants(tree, pinfo, visited)
  if IS_TSHARK and not visited then
    self.wanted = self.wanted or ask_first(self, tree, pinfo)
    return self.wanted
  end
  return tree.hidden and ask(self, tree) or LIST
end

--- Add the names of the protocols to a tree in which no field of YAPP is wanted, for -z io,phs.
-- wants       of the tree
-- is_message  whether there is a message's name too
-- COMPAT 4.0, 4.4: from 4.6 on `referenced` tells.
function Tree:add_protocol_names(tree, wants, is_message)
  add(tree, self.yapp)
  if is_message and not wants.taurus then add(tree, self.taurus) end
end

-- Items of YAPP's ---------------------------------------------------------------------------------

--- Add an expert item of YAPP's.
-- name  its filter without "yapp."
-- text  see show.fields, add_expert
function Tree.expert(_, item, name, text)
  show_fields.add_expert(item, "yapp." .. name, text)
end

--- Add the id, with the name that the user's mapping gives it.
-- range   TvbRange, nil where the CAN id has it
-- source  of message.types
function Tree:add_id(item, range, source)
  local id, title = source.id, source.message and source.message.title
  local pf = self.fields.id
  local added = range and add(item, pf, range, id) or set_generated(add(item, pf, id))
  if title == self.default_names[id] then return end
  added:set_text(("Message ID: %s (0x%08x)"):format(title or "Unknown", id))
end

--- Add the bus, where there is one, and the source.
-- source  of message.types
function Tree:add_source(item, source)
  local fields = self.fields
  if source.bus then set_generated(add(item, fields.bus, source.bus)) end
  set_generated(add(item, fields.source, source.text))
end

--- Add the frames that a message was put together from.
-- whole    TvbRange
-- keys     of its frames; one that a read filter dropped has a fraction, and gets no link
-- length   in bytes
-- payload  TvbRange of the message's payload, nil where it has none
function Tree:add_fragments(item, whole, keys, length, payload)
  local fields = self.fields
  local list = set_generated(add(item, fields.fragments, whole))
  list:set_text(("%d fragments (%d bytes)"):format(#keys, length))
  for _, key in ipairs(keys) do
    if key % 1 == 0 then set_generated(add(list, fields.fragment, number_of(key))) end
  end
  set_generated(add(list, fields["fragment.count"], #keys))
  set_generated(add(list, fields["reassembled.length"], length))
  if payload then set_generated(add(list, fields["reassembled.data"], payload)) end
end

--- Add a CRC with its status, and append the status to the item's text.
-- range     TvbRange of the CRC or nil where it was sent in another frame
-- transfer  { status, calculated }
-- sent      the CRC, where there is no range
function Tree:add_crc(item, range, transfer, sent)
  local shown, fields = CRC[transfer.status] or UNVERIFIED, self.fields
  local crc = range and show_fields.add_le(item, fields.crc, range)
    or set_generated(add(item, fields.crc, sent))
  append_text(crc, shown[2]:format(transfer.calculated))
  set_generated(add(item, fields["crc.status"], shown[1]))
  if shown == CRC.bad then
    set_generated(add(item, fields["crc.calculated"], transfer.calculated))
  end
  append_text(item, shown[3])
end

--- Say that a CRC is bad, with the received and the expected one.
function Tree:bad_crc(item, transfer)
  local text = ("Received 0x%08x, expected 0x%08x"):format(transfer.crc, transfer.calculated)
  self:expert(item, "crc.bad", text)
end

--- Add whether a message has a fault, in each of its frames.
function Tree:add_has_fault(item, has_fault)
  if has_fault then set_generated(add(item, self.fields["message.fault"], true)) end
end

--- Add a message's history to YAPP's own item: the time since the previous one, messages
-- that are missing, whether a fault is set.
-- message  of reading.messages
function Tree:add_delta(item, message)
  local delta, change, fields = message.delta, message.change, self.fields
  if delta then set_generated(add(item, fields.time_delta, show_fields.relative_time(delta))) end
  if change and change.missing then
    set_generated(add(item, fields["seq.missing"], change.missing))
  end
  if message.copy_of then
    set_generated(add(item, fields.copy_of, number_of(message.copy_of)))
  end
  self:add_has_fault(item, message.has_fault)
end

--- Return a number of bytes in words: "1 byte", "2 bytes".
function Tree.bytes(count)
  return count == 1 and "1 byte" or ("%d bytes"):format(count)
end

-- Messages ----------------------------------------------------------------------------------------

-- Add the bytes of a payload from an offset on.
local function add_bytes(self, message, view, name, offset)
  local length, tvb = #message.payload - offset, view.payload_tvb
  if view.wants.yapp and tvb and length > 0 then
    add(view.item, self.fields[name], tvb(view.payload_offset + offset, length))
  end
end

-- Say that a payload does not have the catalogue's size.
-- returns  its text for the Info column
local function add_mismatch(self, message, view)
  local source = message.source
  local least, most = source.min_size, source.size
  local known = least < most and ("%d to %d"):format(least, most) or most
  local text = ("%s, the catalogue says %s"):format(Tree.bytes(message.size), known)
  self:expert(view.item, "size.mismatch", ("%s has %s"):format(source.label, text))
  return ("%s, %s"):format(source.label, text)
end

-- Return the texts about a message that is not in the catalogue.  If a type has its size, they name
-- the preference that decodes it.
-- returns  a text for the packet, and one for the end of the Info column
local function unknown_texts(message)
  local like = message.like
  local text = ("Message ID 0x%x is not in the catalogue"):format(message.source.id)
  if not like then return text, "" end
  local size = "the size of " .. like.title
  local advice = (': see the preference "%s message IDs"'):format(like.title)
  text = ("%s; %d bytes, %s%s"):format(text, message.size, size, advice)
  return text, ", " .. size .. (message.is_advised and advice or "")
end

-- Show a message that is not in the catalogue, or not as it is there: bytes.
local function show_bytes(self, message, view)
  add_bytes(self, message, view, "payload", 0)
  if message.source.message then return add_mismatch(self, message, view) end
  local id, like = message.source.id, message.like
  local text, info = unknown_texts(message)
  if like and view.wants.yapp then
    set_generated(add(view.item, self.fields["like." .. like.name], id))
  end
  self:expert(view.item, "id.unknown", text)
  return ("%s  %s%s"):format(message.source.label, Tree.bytes(#message.payload), info)
end

-- Return what Info says of a message's values.  The source stands in it even if a column shows it
-- where something is wrong: Wireshark's list of expert items has no such column.
local function values_text(message)
  local source = message.source
  local name = message.is_usual and source.short or source.label
  return name .. "  " .. source.write(message.raws)
end

--- Show a finished message: the message of the catalogue, or bytes.
-- message  of reading.messages
-- view     { wants = of Tree:wants; tree = where the Taurus tree goes; item = YAPP's own item, or
--          the tree; payload_tvb and payload_offset = where the payload lies, payload_tvb false if
--          no tree is wanted }
-- returns  its text for the Info column; only a part of that if there are no columns
function Tree:show_message(message, view)
  local top, above, info, source = nil, nil, "", message.source
  if view.wants.yapp then self:add_delta(view.item, message) end
  if not message.raws then
    info = show_bytes(self, message, view)
  else
    if view.payload_tvb or message.remarks then top, above = self.messages:show(message, view) end
    if view.wants.columns then
      info = values_text(message)
    end
  end
  if message.copy_of then
    self:expert(view.item, "copy")
    info = ("%s  [copy of #%d]"):format(info, number_of(message.copy_of))
  end
  if message.change then
    local cleared, words = self.messages:add_change(message, top, view.item, above)
    info = cleared .. info .. words
  end
  if message.has_fault and view.wants.columns then
    info = text_of.faults(source.message, message.raws) .. "  " .. info
  end
  if message.undecoded then
    add_bytes(self, message, view, "undecoded", source.size)
    add_mismatch(self, message, view)
    info = ("%s  [%s, %d not decoded]"):format(info, Tree.bytes(message.size), message.undecoded)
  end
  return info
end

return M
]=])
module("yapp.stat.check", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,check: rules that a capture must keep, the exit code of a gate, a test report for CI.
-- Pure Lua, 5.2 to 5.5.

local groups = require "yapp.stat.groups"
local joined = require "yapp.base.joined"
local measures = require "yapp.stat.measures"
local output = require "yapp.stat.output"
local utf8 = require "yapp.base.utf8"

local M = {}

local words = output.words
-- Verdicts; order = theirs in the text, case = the element of a report in XML.
local FAILED = {
  order = 1,
  json = "false",
  text = "FAILED",
  title = "FAILED",
  case = '<failure message="%s"/>',
  code = output.EXIT_FAILED,
}
local UNJUDGED = {
  order = 2,
  json = "null",
  text = "NOT JUDGED",
  title = "not all of it could be judged",
  case = '<error message="%s"/>',
  code = output.EXIT_UNDECIDED,
}
local OK = {
  order = 3,
  json = "true",
  text = "ok",
  title = "all rules hold",
  case = "<system-out>%s</system-out>",
  code = output.EXIT_OK,
}
local COLUMNS = output.columns {
  { "ok", type = "boolean", where = "json text window", title = "check",
    help = "whether the rule holds; null if it could not be judged" },
  { "rule", type = "string", where = "json text window", help = "the rule" },
  { "who", where = "window" },
  { "bus", where = "json text" },
  { "id", where = "json text" },
  { "source", where = "json text" },
  { "message", where = "json text window" },
  { "frame", where = "json text" },
  { "seen", type = "number", where = "json text window", help = "what was seen" },
  { "limit", type = "text", where = "json", help = "a number, or a text such as `9..11`" },
  { "worst", type = "number", where = "json text window",
    help = "the value that is farthest outside" },
  { "note", type = "text", where = "json text window", help = "why, or what else to know" },
}
--- The columns, see output.columns.
M.COLUMNS = COLUMNS

local NONE = "no message came that this rule applies to"

local Check = groups.class { lists_problems = true }

--- See groups.class.
M.new = Check.new

--- Return the values of a message that rules are about.
function Check:wants(message)
  local list = {}
  for _, rule in ipairs(self.options.rules) do
    if rule.want and rule.message == message then list[#list + 1] = rule.want end
  end
  return list
end

-- Judging -----------------------------------------------------------------------------------------

-- Return whether a rule is about a source.
local function is_about(rule, group)
  local kind, message = rule.kind, group.message
  if not measures.is_of(rule, group.source) then return false end
  if rule.message then return message == rule.message end
  if kind.scope == "rare" then return group.counts[kind.name].seen > 0 end
  if not kind.about then return group.source.id ~= nil end
  local has = message and message[kind.about]
  return has and (type(has) ~= "table" or next(has) ~= nil)
end

-- As a measure: judge a rule that no group is about.  A default rule, or one of rare events, holds
-- if a message of its source came.
local function measure_none(_, rule, check)
  local message, source, is_rare = rule.message, rule.source, rule.kind.scope == "rare"
  if rule.is_default or is_rare then
    for _, group in ipairs(check.list) do
      local has_come = group.count > 0 or group.counts.crc.seen > 0
      local is_seen = has_come and measures.is_of(rule, group.source)
      if is_seen then return 0, nil, not is_rare and NONE end
    end
  end
  local why = NONE
  if message then why = ("no %s came: see yapp.%s_ids"):format(message.title, message.name) end
  if source then why = ("no message of a source that yapp.sources calls %s came"):format(source) end
  return nil, nil, check.ending.reason or why
end

-- Why a rule cannot be judged, whatever was seen; nil for no reason.
-- ok           FAILED if it does not seem to hold
-- is_exceeded  whether more packets cannot make it hold
local function reason_of(kind, group, ending, ok, is_exceeded)
  if kind.needs_time and ending.lacks_times then
    return ending.lacks_times
  end
  if ending.unread and not is_exceeded then return ending.unread end
  if ok == FAILED then return nil end
  if kind.needs_past and group.is_unreliable then
    return "what came before its messages is not known: see -z yapp,events"
  end
  return ending.reason
end

-- Add the row of a rule.
-- seen ...  of a measure
local function add_row(self, rule, group, seen, frame, note, worst)
  local shown = seen and tonumber(("%.12g"):format(seen)) -- 10, not 9.9999999999999982
  local ok = seen and shown >= rule.low and shown <= rule.high and OK or FAILED
  local is_exceeded = seen and shown > rule.high
  local reason = reason_of(rule.kind, group, self.ending, ok, is_exceeded)
  local limit = rule.text:match("=(.*)$")
  if reason or not seen then ok = UNJUDGED end
  self.counts[ok] = self.counts[ok] + 1
  self.rows[#self.rows + 1] = output.row(group.source or { name = rule.source }, {
    ok = ok,
    rule = rule.text,
    limit = tonumber(limit) or limit,
    seen = seen,
    frame = frame,
    note = reason or note,
    worst = worst,
  })
end

-- Add the rows of a rule: one for each of its sources, or one in all.
local function judge(self, rule)
  local measure, about = measures.measure, {}
  if rule.kind.scope == "capture" then
    about[1] = self.capture
  else
    for _, group in ipairs(self:sorted()) do
      if is_about(rule, group) then about[#about + 1] = group end
    end
  end
  if not about[1] then measure, about[1] = measure_none, self.capture end
  for _, group in ipairs(about) do
    add_row(self, rule, group, measure(group, rule, self))
  end
end

-- A report in JUnit's XML ------------------------------------------------------------------------

local ENTITIES = { ["<"] = "&lt;", [">"] = "&gt;", ["&"] = "&amp;", ['"'] = "&quot;" }
local REPORT = '<?xml version="1.0" encoding="UTF-8"?>\n<testsuite name="yapp.check" tests="%d" ' ..
  'failures="%d" errors="%d">\n%s</testsuite>\n'
local NAME, MESSAGE = words("rule bus id source"), words("seen worst note frame")
local NOTE = words("note")

-- XML allows no control characters, not even as entities.
local function escape(text)
  return (utf8.printable(text):gsub('[<>&"]', ENTITIES))
end

-- shape  of the element of a verdict with a text; nil for a rule that holds and has no note
local function case_of(name, shape, text)
  local case = ('  <testcase classname="yapp.check" name="%s"'):format(escape(name))
  if text == "" then return case .. "/>\n" end
  return ("%s>%s</testcase>\n"):format(case, shape:format(escape(text)))
end

-- Return the values that a row has of these keys, as people read them: "seen 1, frame 7".
local function texts_of(row, keys, with_key, between)
  local texts = {}
  for _, key in ipairs(keys) do
    local name = with_key and key .. " " or ""
    if row[key] then
      texts[#texts + 1] = name .. output.text(row[key])
    end
  end
  return table.concat(texts, between)
end

-- Write it if it is asked for; return an error, nil for none.
local function report(self, problems)
  local path, cases, counts = self.options.junit, {}, self.counts
  if not path then return nil end
  for i, row in ipairs(self.rows) do
    local name = row.id and texts_of(row, NAME, false, " ") or row.rule
    local keys = row.ok == OK and NOTE or MESSAGE
    cases[i] = case_of(name, row.ok.case, texts_of(row, keys, true, ", "))
  end
  for _, problem in ipairs(problems) do
    cases[#cases + 1] = case_of(problem, UNJUDGED.case, problem)
  end
  local errors, all = counts[UNJUDGED] + #problems, table.concat(cases)
  return output.save(path, REPORT:format(#cases, counts[FAILED], errors, all))
end

-- The end ---------------------------------------------------------------------------------------

--- End, see stat.derive.
-- returns  the exit code, and a text on errors other than rules, nil for none
function Check:finish(ending, notes, states)
  local options, context, rows = self.options, self.context, {}
  local problems = joined(ending.problems, options.problems)
  self.ending, self.states, self.rows = ending, states, rows
  self.counts = { [FAILED] = 0, [UNJUDGED] = 0, [OK] = 0 }
  for _, rule in ipairs(options.rules) do
    judge(self, rule)
  end
  local problem = report(self, problems)
  if problem then
    problems[#problems + 1] = "the report is not written: " .. problem
  end
  local failed, unjudged = self.counts[FAILED], self.counts[UNJUDGED] + #problems
  local verdict = failed > 0 and FAILED or unjudged > 0 and UNJUDGED or OK
  if not options.json then
    for _, text in ipairs(problems) do rows[#rows + 1] = { ok = UNJUDGED, note = text } end
    output.sort(rows, function(row) return row.ok.order end)
  end
  output.print(context, "YAPP check: " .. verdict.title, COLUMNS, rows, notes)
  if not options.json then
    context.out(("\n%d of %d rules failed, %d not judged\n"):format(failed, #rows, unjudged))
  end
  return verdict.code, problems[1] and "check: " .. table.concat(problems, "\ncheck: ")
end

return M
]=])
module("yapp.stat.csv", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,csv: a table for each message of the catalogue, in a folder or printed.
-- Pure Lua, 5.2 to 5.5.
--
-- FOLDER/motor.csv ...  time, frame, bus, source, id, seq, then the columns of the message
-- FOLDER/fields.json    the description of each column

local field_kinds = require "yapp.message.field_kinds"
local joined = require "yapp.base.joined"
local memo = require "yapp.base.memo"
local output = require "yapp.stat.output"
local text_of = require "yapp.message.text"

local M = {}

local words = output.words
local COLUMNS = output.columns {
  { "file", type = "text", where = "json text window", help = "the path of a table" },
  { "rows", type = "integer", where = "json text window", help = "how many rows it has" },
}
--- The columns of its own output, see output.columns.
M.COLUMNS = COLUMNS
-- The columns in front of a message's own.
local COMMON = {
  { name = "time", type = "time", unit = "s" },
  { name = "frame", type = "integer" },
  { name = "bus", type = "string" },
  { name = "source", type = "string" },
  { name = "id", type = "integer" },
  { name = "seq", type = "integer" },
}
local CRC_GOOD = { { name = "crc_good", type = "bool" } }

local Csv = { wants_messages_only = true }
Csv.__index = Csv

-- Return the cells of a source, "can0,left,528".
local function cells_of(source)
  local bus, name = field_kinds.quoted(source.bus or ""), field_kinds.quoted(source.name or "")
  return ("%s,%s,%d"):format(bus, name, source.id)
end

-- Return the common columns, then the message's.
local function columns_of(self, message)
  return joined(COMMON, self.options.all and CRC_GOOD or {}, text_of.columns(message))
end

-- Begin the table of a message.
local function begin(self, message, file)
  local names = {}
  for i, column in ipairs(columns_of(self, message)) do
    names[i] = field_kinds.quoted(column.name)
  end
  file:write(table.concat(names, ",") .. "\n")
  self.tables[message] = { file = file, rows = 0 }
end

local function path_of(self, name)
  return self.options.folder .. "/" .. name
end

-- Create a file in the folder.  Overwrite one only with the option replace.  Raise why it cannot be
-- written, without those before it.
local function create(self, name)
  local advice = not self.options.replace and "add the option replace to write it anew"
  local file, problem = output.create(path_of(self, name), advice)
  if not file then error("csv: " .. output.finish(self.files, problem), 0) end
  self.files[#self.files + 1] = file
  return file
end

--- options  { folder = path or "-", chosen = compiled message where it is printed, replace =,
--          all = booleans, statistics = see M.describe }
-- context  { queue = a stat.queue, which has the clock; settings = see stat.taps;
--          make_folder = function(path) -> whether it is there; and what output.print takes }
-- It raises why a file cannot be written.
function M.new(options, context)
  local self = setmetatable({
    options = options,
    context = context,
    files = {},
    fields = nil, -- the file
    tables = {}, -- by message: { file, rows = how many it has }
    cells = memo(cells_of), -- by source: a twentieth of the time
  }, Csv)
  if options.chosen then
    begin(self, options.chosen, { write = function(_, text) context.out(text) end })
    return self
  end
  if not context.make_folder(options.folder) then
    error(("csv: the folder %s cannot be made"):format(options.folder), 0)
  end
  self.fields = create(self, "fields.json")
  for _, message in ipairs(context.settings.catalogue.messages) do
    begin(self, message, create(self, message.name .. ".csv"))
  end
  return self
end

--- Take an event, see stat.derive.
function Csv:event(event)
  local all, source, is_good = self.options.all, event.source, event.kind == "message"
  local to = event.raws and self.tables[source.message]
  if not (to and (is_good or all)) then return end
  local time = output.time_text(self.context.queue:clock(event.time))
  local crc_good = all and (is_good and "1," or "0,") or ""
  local row = text_of.row(source.message, event.raws)
  to.file:write(("%s,%d,%s,%d,%s%s\n"):format(
    time, event.frame, self.cells[source], event.seq, crc_good, row))
  to.rows = to.rows + 1
end

-- The meanings of an enum's numbers, in their order: {"0":"Torque Mode","1":"Speed Mode"}.
local function meanings(values)
  local keys, texts = {}, {}
  for value, text in pairs(values) do
    local key = type(value) == "number" and ("%.0f"):format(value) or value
    keys[#keys + 1], texts[key] = key, text
  end
  table.sort(keys, function(a, b) return tonumber(a) < tonumber(b) end)
  return output.object(keys, texts)
end

-- kind, bits and values are for integers only: the type, and the meaning of its numbers.
local COLUMN_KEYS = words("name unit type filter title kind bits values")

local function describe_column(column)
  local field = column.field or {} -- common columns have none
  local about = column.flag or field
  local row = {
    name = column.name,
    unit = column.unit,
    type = column.type,
    filter = about.filter,
    title = about.title,
  }
  if field.kind and column.type == "integer" then
    row.kind, row.bits = field.kind, field.size * 8
    row.values = field.values and meanings(field.values)
  end
  return output.object(COLUMN_KEYS, row)
end

-- The values that are worked out from two fields and are no columns: "name" = "of" - "less".
local DIFFERENCE_KEYS = words("name of less unit title")

local function describe_differences(message)
  local list, is_column = {}, {}
  for _, item in ipairs(message.derived) do is_column[item] = true end
  for _, item in ipairs(message.generated) do
    if not is_column[item] then
      list[#list + 1] = output.object(DIFFERENCE_KEYS, {
        name = item.name,
        of = item.a.name,
        less = item.b.name,
        unit = item.unit,
        title = item.title,
      })
    end
  end
  return output.list(list)
end

--- Describe the columns of all messages and statistics.
-- catalogue  compiled; version: the plugin's own, a text
-- list_of    function(message) -> its columns: the common ones, then message.text's
-- statistics list of { name, columns }, see stat.options
-- returns    JSON: { version = 1, plugin =, messages = { NAME = { title =, every = in seconds or
--            null, columns = list of { those of COLUMN_KEYS }, differences = list of { those of
--            DIFFERENCE_KEYS } } }, statistics = { NAME = { columns = see output.describe } } }
function M.describe(catalogue, version, list_of, statistics)
  local names, messages = {}, {}
  for i, message in ipairs(catalogue.messages) do
    local list = list_of(message)
    for j, column in ipairs(list) do
      list[j] = describe_column(column)
    end
    names[i] = message.name
    messages[message.name] = output.object(words("title every columns differences"), {
      title = message.title,
      every = message.every,
      columns = output.list(list),
      differences = describe_differences(message),
    })
  end
  local whats, described = {}, {}
  for i, row in ipairs(statistics) do
    whats[i] = row.name
    described[row.name] = output.object({ "columns" }, { columns = output.describe(row.columns) })
  end
  return output.object(words("version plugin messages statistics"), {
    version = 1,
    plugin = version,
    messages = output.object(names, messages),
    statistics = output.object(whats, described),
  }).json
end

--- End, see stat.derive.  A file that could not be written is EXIT_UNDECIDED.
function Csv:finish(_, notes)
  if self.options.chosen then return end
  local context, settings, rows = self.context, self.context.settings, {}
  local function list_of(message) return columns_of(self, message) end
  local statistics = self.options.statistics
  self.fields:write(M.describe(settings.catalogue, settings.version, list_of, statistics) .. "\n")
  local problem = output.finish(self.files)
  if problem then return output.EXIT_UNDECIDED, "csv: " .. problem end
  for i, message in ipairs(settings.catalogue.messages) do
    rows[i] = { file = path_of(self, message.name .. ".csv"), rows = self.tables[message].rows }
  end
  local title = "YAPP csv: " .. output.count(#rows, "table")
  output.print(context, title, COLUMNS, rows, notes)
end

return M
]=])
module("yapp.stat.derive", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- Feeds one statistic with the events that its filter lets count.  Derives events from messages:
-- faults, reboots, silences and other changes, and messages that were not decoded.  At the end:
-- faults that are still active, and sources that never came.  Pure Lua, 5.2 to 5.5.
--
-- A statistic has
--   event(event, now, cause)  takes an event that counts: now = seconds without the steps back of
--                             the capture's clock; cause = the event of the message that shows it
--   finish(ending, notes, states)  ends; returns the exit code and a text, each nil for none:
--                             ending = see Queue:finish; notes = texts on all that its answer
--                             leaves out; states = by source, see new_state
--   follows_changes           whether it shows changes since the message before
--   lists_problems            whether it lists ending.problems itself
--   wants_messages_only       whether it needs no events but good messages and those with a bad CRC

local joined = require "yapp.base.joined"
local kinds = require "yapp.stat.kinds"
local memo = require "yapp.base.memo"
local output = require "yapp.stat.output"
local undecoded = require "yapp.stat.undecoded"

local M = {}

local new_event, span, NOTHING = kinds.event, kinds.span, kinds.NOTHING
local MAX_GAP = 1.5 -- periods; a longer gap has room for another message
local NO_SPANS = "how long faults, gaps and silences lasted is not known"
local LEFT_OUT = "changes of faults, reboots and gaps are unreliable and left out"
local UNRELIABLE = "nothing tells the buses of %s apart: " .. LEFT_OUT
local SHARED = "two controllers appear to send %s: from frame %d on " .. LEFT_OUT

local Deriver = {}
Deriver.__index = Deriver

-- The state of a source with good messages.
local function new_state()
  return {
    last = nil, -- its latest message
    last_at = nil, -- when that came, by the stamps of its source
    ahead = 0, -- seconds that the capture's clock was ahead then
    is_counted = false, -- whether that counts
    faults = NOTHING, -- list of those that are set, as they rose, see message.faults
    counted = { frame = 0 }, -- the latest reliable message that counts
    counted_at = nil,
    counted_faults = NOTHING, -- the faults that were set then
    is_numbered = false, -- whether Seq No numbers its messages: it changed
    missing_by_period = 0, -- number of messages that fit into the gaps between its messages
  }
end

--- Make the deriver of a statistic.
-- settings  see stat.taps
-- options   of stat.options
function M.new(settings, statistic, options)
  local states = {}
  return setmetatable({
    statistic = statistic,
    -- A set of the numbers of packets that the filter lets count, nil without one: a tap fills it.
    -- It keeps all packets, as only the end shows which messages are unfinished.
    matched = options.filter and {},
    settings = settings,
    options = options,
    undecoded = undecoded.new(settings),
    states = states, -- of sources with good messages, in their order, and by source
    by_source = memo(new_state, states),
    raised_at = {}, -- [fault] = when it rose, see above: until the message counts that clears it
    came = {}, -- sources with an event that counts
    copies = 0, -- number of messages that were recorded once more, or several times
    originals = {}, -- [source] = frame key of the latest of them
    -- Of events, by kind, where a fault may be hidden; false if nothing is to be said of that.
    counts = (options.looks_for_faults or options.row.looks_for_faults) and {} or false,
    unreliable_notes = {}, -- texts: why the history of a source is unreliable; and by source
    now = nil, -- seconds of the capture, see above
  }, Deriver)
end

-- Return whether a message of a source may have a fault: an unknown message may.
local function may_have_faults(source)
  return not source.message or source.message.alarms[1] ~= nil
end

--- Hand an event to the statistic.
-- cause  the event of the message that shows it
function Deriver:add(event, cause)
  if self.statistic.wants_messages_only and event.kind ~= "message" and event.kind ~= "crc" then
    return
  end
  local counts = self.counts
  if counts and may_have_faults(event.source) then
    counts[event.kind] = (counts[event.kind] or 0) + (event.values.count or 1)
  end
  self.statistic:event(event, self.now, cause or event)
end

local function emit(self, kind, cause, values)
  local event = new_event(kind, cause.frame, cause.time, cause.source, values)
  event.rel = cause.rel
  self:add(event, cause)
end

-- Return whether the filter lets an event count.
local function lets_count(self, event)
  return not self.matched or self.matched[event.frame]
end

-- Faults ------------------------------------------------------------------------------------------

-- event  "raised", "cleared", or "active" at the end
local function emit_fault(self, cause, fault, event)
  local flag, active = fault.flag, nil
  if event ~= "raised" then
    local till = event == "cleared" and self.now or self.by_source[cause.source].counted_at
    -- A step back of less than a millisecond is none, see stat.queue.
    active = output.seconds(math.max(0, span(self.raised_at[fault] or till, till)))
  end
  emit(self, "fault", cause, {
    field = fault.field,
    flag = flag.name,
    help = flag.help,
    event = event,
    incident = fault.incident,
    active = active,
    after = active and (" after %s s"):format(active.short),
  })
end

-- Note the faults that rise or fall with a message.
local function note_faults(self, state, cause, faults)
  state.faults = faults.set
  for _, step in ipairs(faults) do
    local fault, is_raised = step.fault, step.is_raised
    if is_raised then self.raised_at[fault] = self.now end
    if state.is_counted then
      emit_fault(self, cause, fault, is_raised and "raised" or "cleared")
      if not is_raised then self.raised_at[fault] = nil end
    end
  end
end

-- Messages ----------------------------------------------------------------------------------------

-- Emit the events of a message that counts, but for its faults.
local function note_events(self, event, change)
  for _, row in ipairs(kinds.LIST) do
    local key, value = row.change, change[row.name]
    if key and value then
      value = key == "length" and output.seconds(value) or value
      emit(self, row.name, event, { [key] = value })
    end
  end
  for _, values in ipairs(event.values.invalid or NOTHING) do
    emit(self, "invalid", event, values)
  end
  local source, notes = event.source, self.unreliable_notes
  if event.values.is_unreliable and not notes[source] then
    local shape = change.shared and SHARED or UNRELIABLE
    notes[source] = true
    notes[#notes + 1] = shape:format(output.bus_and_id(source), event.frame)
  end
end

-- Return how many messages of a source fit between two times.
local function missing_between(state, from, to)
  local message = state.last.source.message
  if not (message and message.every) then return 0 end
  local periods = span(from, to) / message.every
  return periods > MAX_GAP and math.floor(periods - 0.5) or 0
end

local function note_message(self, event, is_counted, capture_now)
  local state, values = self.by_source[event.source], event.values
  local change = values.change or NOTHING
  if state.is_counted and not values.is_unreliable then
    local missing = missing_between(state, state.last_at, self.now)
    state.missing_by_period = state.missing_by_period + missing
  end
  if change.late and state.is_counted then
    emit(self, "silence", state.last, { length = output.seconds(change.late) })
  end
  state.last, state.last_at, state.is_counted = event, self.now, is_counted
  state.ahead = capture_now - self.now
  if is_counted and values ~= NOTHING then note_events(self, event, change) end
  if change.faults then note_faults(self, state, event, change.faults) end
  if is_counted and not values.is_unreliable then
    state.is_numbered = state.is_numbered or event.seq ~= (state.counted.seq or event.seq)
    state.counted, state.counted_at, state.counted_faults = event, self.now, state.faults
  end
end

-- Count a message that has copies, once for all of them.
local function note_copy(self, event)
  local source, original = event.source, event.values.of
  if self.originals[source] ~= original then self.copies = self.copies + 1 end
  self.originals[source] = original
end

--- Take an event, in the order of the capture.  If the filter does not let it count, it still
-- updates the states.
-- now          seconds of the capture, see above
-- capture_now  the same by the stamps of all sources, which may be those of another recorder
function Deriver:take(event, now, capture_now)
  local is_counted, is_message = lets_count(self, event), event.kind == "message"
  self.now = now
  if is_counted then
    self.came[event.source] = true
    if event.kind == "copies" then note_copy(self, event) end
    local size = is_message and event.values.size
    if size then
      local rest = event.values.undecoded
      emit(self, "unknown", event, self.undecoded:note(event.source, size, rest))
    end
  end
  if is_message and not self.statistic.wants_messages_only then
    note_message(self, event, is_counted, capture_now)
  end
  if is_counted then self:add(event) end
end

-- The end -----------------------------------------------------------------------------------------

-- Possible messages that are not dissected.  If other messages came, they are `unknown` events.
local function end_undissected(self, ending)
  for _, event in ipairs(ending.undissected) do
    if lets_count(self, event) then
      local values = self.undecoded:note(event.source, event.values.size)
      if not ending.reason then emit(self, "unknown", event, values) end
    end
  end
end

-- Silences that last to the end of the capture.
local function end_silences(self, ending)
  for _, state in ipairs(self.states) do
    local event = state.last
    local message = event.source.message
    local length = span(state.last_at + state.ahead, ending.now)
    local is_silent = message and message.every and length > self.settings.late * message.every
    if is_silent and state.is_counted and not event.values.is_unreliable then
      local values = { length = output.seconds(length), is_last = true }
      emit(self, "silence", event, values)
    end
  end
end

-- The faults that are still set at the last message of their source that counts.
local function end_faults(self)
  output.sort(self.states, function(state) return state.counted.frame end)
  for _, state in ipairs(self.states) do
    for _, fault in ipairs(state.counted_faults) do
      emit_fault(self, state.counted, fault, "active")
    end
  end
end

local function end_absences(self, ending)
  for _, row in ipairs(self.settings.sources:list()) do
    local is_absent = row.message
    for source in pairs(self.came) do
      local is_there = not row.bus or row.bus == source.bus
      if is_there and source.id == row.id and source.name == (row.name or source.name) then
        is_absent = false
      end
    end
    if is_absent then
      local event = new_event("absent", nil, ending.rel, row)
      event.rel = ending.now
      self:add(event)
    end
  end
end

-- The packets that were lost while capturing.
local function end_drops(self, ending)
  for _, drop in ipairs(ending.drops) do
    local time = drop.time and math.floor((drop.time - ending.begin) * 1e6 + 0.5) / 1e6
    local values = { count = drop.count }
    self:add(new_event("dropped", drop.frame, time, { bus = drop.bus }, values))
  end
end

-- Return a text: how many damaged or lost messages may have had a fault; nil for none.
local function hiding(self, now)
  local texts, missing = {}, 0
  for _, state in ipairs(self.states) do
    if may_have_faults(state.last.source) then
      if not state.is_numbered then missing = missing + state.missing_by_period end
      local has_end = state.is_counted and not state.last.values.is_unreliable
      local last_at = state.last_at + state.ahead
      if has_end then missing = missing + missing_between(state, last_at, now) end
    end
  end
  for _, row in ipairs(kinds.LIST) do
    local count = row.hides and self.counts[row.name]
    if count then texts[#texts + 1] = ("%d %s"):format(count, row.hides) end
  end
  if missing > 0 then texts[#texts + 1] = ("%d missing by their period"):format(missing) end
  return texts[1] and "damaged or lost messages may hide faults: " .. table.concat(texts, ", ")
end

-- Return how many messages were recorded twice, a text; nil for none.
local function copies_text(count)
  local shape = count == 1 and "%s was recorded twice; it counts once" or
    "%s were recorded twice; each counts once"
  return count > 0 and shape:format(output.count(count, "message")) or nil
end

-- Return the texts on all that the answer leaves out, and whether they make it undecided.
local function notes_of(self, ending)
  local reason, matched = ending.reason, self.matched
  if matched and not next(self.came) then reason = reason or "no message matches the filter" end
  local unreliable = self.statistic.follows_changes and self.unreliable_notes or NOTHING
  local problems = self.statistic.lists_problems and NOTHING or ending.problems
  local no_times = ending.lacks_times and ending.lacks_times .. ": " .. NO_SPANS
  local notes = joined(problems, { reason }, { no_times }, self.undecoded:texts(), unreliable)
  notes[#notes + 1] = copies_text(self.copies)
  if self.counts then notes[#notes + 1] = hiding(self, ending.now) end
  if not matched then notes[#notes + 1] = ending.hint end
  return notes, ending.problems[1] ~= nil or unreliable[1] ~= nil
end

--- End: all events have come.
-- ending   see Queue:finish
-- returns  the exit code, nil for 0; a text to say, or nil; and a list of texts to say
function Deriver:finish(ending)
  end_undissected(self, ending)
  end_silences(self, ending)
  end_faults(self)
  end_absences(self, ending)
  end_drops(self, ending)
  local notes, is_undecided = notes_of(self, ending)
  local code, text = self.statistic:finish(ending, notes, self.by_source)
  if is_undecided then return code or output.EXIT_UNDECIDED, text, notes end
  local has_no_notes = self.options.json or self.options.row.table_only
  return code, text, has_no_notes and notes or NOTHING
end

return M
]=])
module("yapp.stat.events", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,events: all events, in the order of time; and -z yapp,faults: the faults among these,
-- when each flag rose and fell, on which source, for how long.  Pure Lua, 5.2 to 5.5.

local joined = require "yapp.base.joined"
local kinds = require "yapp.stat.kinds"
local output = require "yapp.stat.output"

local M = {}

local WHEN_AND_WHO = {
  { "time", where = "json text" },
  { "rel", where = "text window" },
  { "frame", where = "json text" },
  { "who", where = "window" },
  { "bus", where = "json text" },
  { "id", where = "json text" },
  { "source", where = "json text" },
}
local KIND = { "kind", type = "string", where = "json",
  help = "what happened: `fault`, `reboot`, `silence` and others, see statistics.md" }
-- A line of JSON has the keys of its kind alone, see stat.kinds.
local EVENTS = output.columns(joined({ KIND }, WHEN_AND_WHO, {
  { "message", where = "json text window" },
  { "kind", where = "text", title = "event" },
  { "details", where = "text window" },
  -- The values of the kinds:
  { "field", where = "" },
  { "flag", where = "" },
  { "event", where = "" },
  { "active", where = "" },
  { "length", type = "seconds", unit = "s", where = "",
    help = "of a silence, a jump or a step of the clock; of `skipped`: bytes" },
  { "what", type = "string", where = "", help = "of `incomplete`: what was wrong with it" },
  { "value", type = "text", where = "", help = "of `invalid`: what the field had" },
  { "size", type = "integer", where = "", help = "of `unknown`: bytes of each message" },
  { "count", type = "integer", where = "", help = "how many messages or packets; null for one" },
  { "like", type = "string", where = "", help = "of `unknown`: the message that has this size" },
}))
local FAULTS = output.columns(joined(WHEN_AND_WHO, {
  { "message", where = "json text" },
  { "field", where = "json text" },
  { "flag", where = "json text window" },
  { "event", where = "json text window" },
  { "active", where = "json text window" },
  { "help", type = "string", where = "json text", help = "what the catalogue says of the flag" },
}))
--- The columns of both, see output.columns.
M.COLUMNS = { events = EVENTS, faults = FAULTS }

-- The keys of a line of JSON, by kind.
local KEYS_OF_KIND = {}
for _, row in ipairs(kinds.LIST) do
  KEYS_OF_KIND[row.name] = joined(EVENTS.json, output.words(row.keys or ""))
end

local Events = { follows_changes = true }
Events.__index = Events

--- Make the statistic.
-- options  { what = "events" or "faults" }
-- context  { queue = a stat.queue, which has the clock; and what output.print
--          takes }
function M.new(options, context)
  return setmetatable({ what = options.what, context = context, list = {} }, Events)
end

--- Take an event, see stat.derive.  Of messages that were not decoded, keep the first event of each
-- source and size alone.
function Events:event(event)
  local row = kinds.BY_NAME[event.kind]
  local is_listed = self.what == "events" and row and not row.is_counted_only
  local is_wanted = is_listed or event.kind == "fault"
  local is_repeated = event.kind == "unknown" and event.values.count > 1
  if is_wanted and not is_repeated then
    self.list[#self.list + 1] = event
  end
end

local function row_of(self, event, ending)
  local values, time = event.values, event.time
  local row = {
    kind = event.kind,
    frame = event.frame,
    time = time and output.time(self.context.queue:clock(time)),
    rel = output.seconds(event.rel),
    details = nil,
    keys = self.what == "events" and KEYS_OF_KIND[event.kind] or nil,
  }
  for key, value in pairs(values) do
    row[key] = value
  end
  if ending.lacks_times then row.active, row.after = nil, nil end
  local function fill(key) return output.text(row[key], true) end
  row.details = kinds.BY_NAME[event.kind].text:gsub("{(%w+)}", fill)
  return output.row(event.source, row)
end

-- By time, also where the capture's clock went back; then by frame.  Events without a time come
-- last.
local function order_of(event)
  return event.rel or math.huge, event.frame or math.huge
end

-- Return how many times a source had faults: one for all flags that are set without a break.
local function count_incidents(list)
  local seen, count = {}, 0
  for _, event in ipairs(list) do
    local incident = event.values.incident
    if not seen[incident] then seen[incident], count = true, count + 1 end
  end
  return count
end

--- End, see stat.derive.  It always ends well.
function Events:finish(ending, notes)
  local what, list = self.what, {}
  for _, event in ipairs(self.list) do
    local is_sure = not (ending.lacks_times and kinds.BY_NAME[event.kind].needs_time)
    if is_sure then list[#list + 1] = event end
  end
  if what == "events" then output.sort(list, order_of) end
  local count = what == "faults" and count_incidents(list) or #list
  local title = ("YAPP %s: %d"):format(what, count)
  output.print(self.context, title, M.COLUMNS[what], list, notes, function(event)
    return row_of(self, event, ending)
  end)
end

return M
]=])
module("yapp.stat.groups", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The gathering of a statistic: of each source counts, times, gaps and values; of all sources of
-- one message, how far their values lie apart.  Pure Lua, 5.2 to 5.5.

local field_kinds = require "yapp.message.field_kinds"
local kinds = require "yapp.stat.kinds"
local memo = require "yapp.base.memo"
local output = require "yapp.stat.output"

local M = {}

local span = kinds.span
local number_of_raw = field_kinds.number
local INFINITE = math.huge
local NO_NUMBER = 0 / 0

-- Return a value as a number: in its unit, a time in seconds, flags and codes as they are sent; NaN
-- for a reserved value, nil where the message does not have the field.
local function number_of(values, raws)
  local field, raw = values.field, raws[values.index]
  if values.index then return raw and number_of_raw(field, raw) end
  return field_kinds.value(field, raws)
end

-- A number with the digits that people see.
local function rounded(field, value)
  local shape = field.shape
  return shape and tonumber(shape:format(value)) or value -- NaN stays
end

-- Values ----------------------------------------------------------------------------------------

-- Make the record of a field of a source.
local function new_values(want, spread)
  local field, is_judged = want.field, spread or want.low or want.high
  return {
    field = field,
    index = field.index or false, -- a derived value has none
    -- The highest raw value that is a number, where raw values are gathered: see note_values.
    ordinary = not is_judged and field_kinds.linear_top(field) or false,
    low = want.low or -INFINITE,
    high = want.high or INFINITE,
    lets_reserved = want.lets_reserved, -- whether a reserved value is not outside
    count = 0, -- of numbers, whose least, sum and largest follow, or those of raw values
    min = INFINITE,
    sum = 0.0,
    max = -INFINITE,
    seen = 0, -- number of all values
    outside = 0, -- number of those beyond the limits
    by = 0, -- how far the worst of these is beyond; worst = this value, frame = its frame
    spread = spread, -- of all sources, where they are compared
    latest = NO_NUMBER, -- number
    latest_at = nil, -- when it came
  }
end

local function note_value(values, value, frame)
  values.seen = values.seen + 1
  if value == value then
    values.count = values.count + 1
    values.sum = values.sum + value
    if value < values.min then values.min = value end
    if value > values.max then values.max = value end
  end
  if value >= values.low and value <= values.high then
    return
  end
  value = rounded(values.field, value)
  local by = math.max(values.low - value, value - values.high)
  if value ~= value then by = values.lets_reserved and 0 or INFINITE end -- beyond all, or not
  if by <= 0 then return end
  values.outside = values.outside + 1
  if by > values.by then
    values.by, values.worst, values.frame = by, value, frame
  end
end

-- Note how far the latest values of all sources lie apart: the largest spread so far, and the event
-- that shows it.  Needs values of two sources at one time.
-- longest  seconds for which a value stays valid
local function note_spread(values, value, event, now, longest)
  local spread, low, high, count = values.spread, INFINITE, -INFINITE, 0
  values.latest, values.latest_at = rounded(values.field, value or NO_NUMBER), now
  for _, one in ipairs(spread.members) do
    local latest = one.latest
    if latest == latest and span(one.latest_at, now) <= longest then
      if latest < low then low = latest end
      if latest > high then high = latest end
      count = count + 1
    end
  end
  if count < 2 then return end
  local apart = tonumber(("%.7g"):format(high - low)) -- no 0.30000000000000004
  if apart > (spread.worst or -1) then
    spread.worst, spread.frame, spread.rel = apart, event.frame, event.time
  end
end

-- Groups ----------------------------------------------------------------------------------------

-- How many events of a kind there are; frame and values = of the first, cause = of the latest.
local function new_count()
  return { seen = 0, frame = nil, values = kinds.NOTHING, cause = nil }
end

local function new_spread()
  return { members = {}, worst = nil, frame = nil, rel = nil }
end

-- Make the record of a source: {
--   source, message = the source's
--   counts = { [kind of event] = see new_count }
--   count = of good messages, decoded = of those that were decoded; first, last = their times,
--   last_frame
--   gap_min, gap_max = seconds, gap_max_frame
--   silent = how long it has been silent at the capture's end, if that is a silence
--   is_unreliable = whether one of them had an unreliable history
--   values = a list, also by entry of Groups:wants
--   bus_order = number of groups before the first one of its bus }
local function new_group(self, source)
  local message, all = source.message, {}
  for i, want in ipairs(message and self.wanted[message] or {}) do
    local spread = want.is_spread and self.spreads[want]
    local values = new_values(want, spread)
    if spread then table.insert(spread.members, values) end
    all[i], all[want] = values, values
  end
  return {
    source = source,
    message = message,
    counts = memo(new_count),
    count = 0,
    decoded = 0,
    values = all,
    bus_order = self.bus_orders[source.bus_key or false],
  }
end

local Groups = {}

--- Make a class of statistics that gather by source.
-- class    its own methods, see stat.derive; wants, if it gathers other fields than all that are
--          numbers; compares = whether it gathers their spreads, too
-- returns  it, with class.new(options, context), which makes a statistic:
--   options  of stat.options
--   context  { queue = a stat.queue, which has the clock; settings = see stat.taps;
--            and what output.print takes }
function M.class(class)
  class.__index = class
  function class.new(options, context)
    local list = {}
    local self = setmetatable({
      options = options,
      context = context,
      list = list, -- of groups
      by_source = nil,
      capture = { counts = memo(new_count) }, -- a group: the events of the whole capture
      absent = {}, -- by source: whether none of its messages came
      wanted = nil, -- by message: see Groups:wants
      spreads = memo(new_spread), -- by entry of Groups:wants
      bus_orders = memo(function() return #list end), -- [bus] = how many groups came before it
    }, class)
    self.by_source = memo(function(source) return new_group(self, source) end, list)
    self.wanted = memo(function(message) return self:wants(message) end)
    return self
  end
  return setmetatable(class, { __index = Groups })
end

--- Return the fields of a message that are gathered: numbers that are no codes.
function Groups:wants(message)
  local list = {}
  for _, fields in ipairs { message.fields, message.generated } do
    for _, field in ipairs(fields) do
      if field_kinds.is_number(field) then
        list[#list + 1] = { field = field, is_spread = self.compares }
      end
    end
  end
  return list
end

-- amount  to add; nil for 1, but only once for all events of one cause
local function add(group, kind, event, cause, amount)
  local count, frame = group.counts[kind], event.frame
  if frame and frame < (count.frame or INFINITE) then
    count.frame, count.values = frame, event.values
  end
  if amount or count.cause ~= cause then
    count.seen = count.seen + (amount or 1)
  end
  count.cause = cause
end

-- Note the raw value of a field whose numbers grow with it: M.row works out the numbers of the
-- least, the sum and the largest.  This halves the time of a summary's values.
local function note_raw(values, raw)
  values.seen = values.seen + 1
  if raw > values.ordinary then return end
  values.count = values.count + 1
  values.sum = values.sum + raw
  if raw < values.min then values.min = raw end
  if raw > values.max then values.max = raw end
end

local function note_values(self, group, event, now)
  local every, raws = group.message.every, event.raws
  local longest = every and self.context.settings.late * every or INFINITE
  for _, values in ipairs(group.values) do
    if values.ordinary then
      local raw = raws[values.index]
      if raw then note_raw(values, raw) end
    else
      local value = number_of(values, raws)
      if value then note_value(values, value, event.frame) end
      if values.spread then note_spread(values, value, event, now, longest) end
    end
  end
end

local function note_message(self, event, now)
  local group, frame = self.by_source[event.source], event.frame
  if group.last then
    local gap = span(group.last, now)
    if gap > (group.gap_max or -INFINITE) then group.gap_max, group.gap_max_frame = gap, frame end
    group.gap_min = math.min(gap, group.gap_min or gap)
  end
  group.first = group.first or now
  group.last, group.last_frame = now, frame
  group.count = group.count + 1
  group.is_unreliable = group.is_unreliable or event.values.is_unreliable
  if not event.raws then return end
  group.decoded = group.decoded + 1
  note_values(self, group, event, now)
end

--- Take an event, see stat.derive.  Of faults those that rose count.
function Groups:event(event, now, cause)
  local kind, values = event.kind, event.values
  local row = kinds.BY_NAME[kind]
  if not row then return note_message(self, event, now) end
  if kind == "fault" and values.event ~= "raised" then
    return
  end
  if kind == "absent" then self.absent[event.source] = true end
  local group = row.scope == "capture" and self.capture or self.by_source[event.source]
  add(group, row.counts_as or kind, event, cause, values[row.amount])
  if kind ~= "silence" then return end
  if values.is_last then
    group.silent = values.length
  else
    add(group, "late", event, cause)
  end
end

--- Return the mean rate in Hz, nil where no two messages are at two times; and the mean gap in
-- seconds.
function M.pace(group)
  local gaps = group.count - 1
  if gaps < 1 then return nil end
  local length = span(group.first, group.last)
  return length > 0 and gaps / length or nil, length / gaps
end

--- Return a row with the range of a field of a source.
function M.row(group, values)
  local field, count = values.field, values.count
  local row = output.row(group.source, { field = field.name, unit = field.unit, count = count })
  if count == 0 then return row end
  local min, mean, max = values.min, values.sum / count, values.max
  if values.ordinary then
    min, max = number_of_raw(field, min), number_of_raw(field, max)
    mean = number_of_raw(field, mean)
  end
  row.min, row.mean, row.max = rounded(field, min), mean, rounded(field, max)
  return row
end

--- Return all groups by bus in the order in which buses showed, then by ID.  A stream itself has no
-- ID and comes first.
function Groups:sorted()
  output.sort(self.list, function(group) return group.bus_order, group.source.id or -1 end)
  return self.list
end

return M
]=])
module("yapp.stat.intake", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The statistics' ear: makes events of the results of the reading.  Pure Lua, 5.2 to 5.5.
--
-- The values of a good message's event are kinds.NOTHING for most messages, else {
--   change         of message.history, or nil
--   invalid        list of values of `invalid` events, or nil
--   size           number of its bytes, if the catalogue does not decode all of them
--   undecoded      number of these bytes behind those that the catalogue has, or nil
--   is_unreliable  whether what came before the message is not known }
-- The values of a loss are {
--   shown    { what = "incomplete", "orphan" or "overrun" }: its values once it is handed on
--   lost     a value that all losses of one message share, or nil
--   anomaly  { is_withdrawn = whether nothing is lost after all, is_open = whether that may
--            change } }

local can_id = require "yapp.wire.can_id"
local compiler = require "yapp.message.catalogue"
local field_kinds = require "yapp.message.field_kinds"
local kinds = require "yapp.stat.kinds"
local memo = require "yapp.base.memo"

local M = {}

local END = can_id.END

local LOSSES = {
  ["fragment.incomplete"] = { what = "incomplete" },
  ["fragment.orphan"] = { what = "orphan" },
  ["fragment.overrun"] = { what = "overrun" },
}
-- The kind of a message by its status.  A truncated message could not be checked.  A message of
-- another status makes no event: its anomalies do.
local KIND_OF = { good = "message", bad = "crc", truncated = "incomplete" }

local Intake = {}
Intake.__index = Intake

-- The state of a source.
local function new_state()
  return {
    orphan = false, -- or { seq }: the message that lost its Start, while its frames come
    unknown_seq = nil, -- the latest, see report_undissected
  }
end

--- Make an intake, which is closed.
-- catalogue  compiled
function M.new(catalogue)
  local self = setmetatable({
    catalogue = catalogue,
    queue = nil, -- a stat.queue, while it is open
    leaving = {}, -- taps, see Intake:remove_later
    states = nil, -- by source
    has_orphans = false, -- whether a state has had an orphan
    stretches = nil, -- by line: skipped bytes, while nothing else comes
  }, Intake)
  return self
end

--- Begin to hand on events.  What an earlier reading left behind is forgotten.
function Intake:open(queue)
  self:reset()
  self.queue = queue
end

--- Hand on no more events.
function Intake:close()
  self.queue = nil
end

--- Forget what was read.
function Intake:reset()
  self.states, self.stretches, self.has_orphans = memo(new_state), {}, false
end

--- Remove a tap when the next event of a message comes: a tap cannot go while it is called.
function Intake:remove_later(tap)
  table.insert(self.leaving, tap)
end

-- Return the event of a message or frame.
-- message  of reading.messages, or a frame of reading.records
local function new_event(kind, message, values)
  return kinds.event(kind, message.number, message.time, message.source, values, message)
end

local function offer(self, kind, message, values)
  local line, leaving = message.source.line, self.leaving
  if self.stretches[line] then self.stretches[line] = nil end -- a needless nil costs in 5.2
  if leaving[1] then
    self.leaving = {}
    for _, tap in ipairs(leaving) do tap:remove() end
  end
  self.queue:offer(new_event(kind, message, values), message.visited)
end

-- Messages ----------------------------------------------------------------------------------------

-- The values of a message that the catalogue does not define; nil for none.
local function invalid_of(message)
  local of_type, list = message.source.message, nil
  for _, remark in ipairs(message.remarks) do
    local index, is_undefined = remark[1], remark[3]
    if is_undefined then
      local field, raw = of_type.fields[index], message.raws[index]
      local shape = field_kinds.BY_NAME[field.kind].code or "0x%02x" -- as the document has it
      list = list or {}
      list[#list + 1] = {
        field = field.name,
        value = raw,
        code = shape:format(raw),
        effect = remark[2] == "command.key.invalid" and " (the controller ignores this command)",
      }
    end
  end
  return list
end

local function values_of(message)
  local invalid = message.remarks and invalid_of(message)
  local is_decoded = message.raws and not message.undecoded
  if is_decoded and not (message.change or invalid or message.is_unreliable) then
    return kinds.NOTHING
  end
  return {
    change = message.change or nil,
    invalid = invalid or nil,
    size = not is_decoded and #message.payload or nil,
    undecoded = message.undecoded or nil,
    is_unreliable = message.is_unreliable or nil,
  }
end

-- Report a message that has ended.
local function report_message(self, message)
  local kind, values = KIND_OF[message.status], nil
  if not kind then return end
  if self.has_orphans then self.states[message.source].orphan = false end
  if message.copy_of then return offer(self, "copies", message, { of = message.copy_of }) end
  if kind == "message" then
    values = values_of(message)
  elseif kind == "incomplete" then
    values = LOSSES["fragment.incomplete"]
  end
  offer(self, kind, message, values)
end

-- Losses ------------------------------------------------------------------------------------------

-- Return a table that stands for one orphaned message: its frames in a row with one Seq No, up to
-- its End, share the table.
local function orphaned(state, seq, is_end)
  local orphan = state.orphan
  if not orphan or orphan.seq ~= seq then
    orphan = { seq = seq }
  end
  state.orphan = not is_end and orphan
  return orphan
end

-- Report the anomalies of a frame.  Anomalies that lose a message, or a part of one, are events.
-- anomalies  list of { expert, lost = frame key of the Start of the message that is lost or nil,
--            is_withdrawn = whether nothing is wrong after all, is_open = whether that may change,
--            is_copy = whether a recorder holds the frame twice, which loses nothing }
local function report_anomalies(self, frame, anomalies)
  local state, fields = self.states[frame.source], frame.can_id
  for _, anomaly in ipairs(anomalies) do
    local shown, lost = LOSSES[anomaly.expert], anomaly.lost
    if shown and not anomaly.is_copy then
      if shown.what == "orphan" then
        lost, self.has_orphans = orphaned(state, frame.seq, fields.ctrl == END), true
      else
        state.orphan = false
      end
      offer(self, "incomplete", frame, { shown = shown, lost = lost, anomaly = anomaly })
    end
  end
end

-- Report bytes of a stream that belong to no frame.  Over several packets in a row they are one
-- stretch, and one event, whose length grows.
-- frame  its source is the line
local function report_skipped(self, frame, length)
  local line, key = frame.source, frame.key
  local stretch = self.stretches[line]
  if stretch and key > stretch.last_key then -- else the capture is read anew
    stretch.last_key = key
    stretch.values.length = stretch.values.length + length
    return
  end
  local values = { length = length }
  self.stretches[line] = { last_key = key, values = values }
  self.queue:offer(new_event("skipped", frame, values), frame.visited)
end

-- Report a frame that may be a message that is not dissected, or the Start of one.  It counts as
-- one if its ID is known, if a message of the catalogue has its size, or if its Seq No follows that
-- of the source's previous such frame.
local function report_undissected(self, frame, size)
  local state = self.states[frame.source]
  local seq, is_message = state.unknown_seq, frame.source.message
  if seq and (seq + 1) % 256 == frame.seq then is_message = true end
  is_message = is_message or compiler.of_size(self.catalogue.messages, size)[1]
  state.unknown_seq = frame.seq
  if is_message then
    self.queue:add_undissected(new_event("undissected", frame, { size = size }))
  end
end

--- Take a result of the reading.
-- result  see reading.records
function Intake:report(result)
  local kind, message, anomalies = result.kind, result.message, result.anomalies
  if message then
    report_message(self, message)
  elseif kind == "skipped" then
    report_skipped(self, result.frame, result.length)
  elseif kind == "undissected" then
    report_undissected(self, result.frame, result.length)
  end
  if anomalies then report_anomalies(self, result.frame, anomalies) end
end

--- Take the results that were still waiting when all packets had come.
-- results  of Reading:finish
-- returns  the events of the messages that the capture ends before, in the order of their frames
function Intake:finish(results)
  local events = {}
  for _, result in ipairs(results) do
    if result.kind == "unfinished" then
      events[#events + 1] = new_event("unfinished", result.frame)
    else
      self:report(result)
    end
  end
  table.sort(events, function(a, b) return a.frame < b.frame end)
  return events
end

return M
]=])
module("yapp.stat.kinds", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The kinds of event, one row each, and the event itself.  The lists of `events`, the keys of JSON,
-- the rules of `check`, the errors of options, the help and the tests come from these rows.
-- Pure Lua, 5.2 to 5.5.
--
-- A new kind is a row here and the code that makes its events.  Of a row with `change`, stat.derive
-- makes them: if a change of message.history has the row's name.

local M = {}

-- name        the first value: in JSON and in rules
-- text        the second one, for people: {key} is a value of the event
-- keys        in JSON, besides those of every event
-- is_optional whether `check` without rules does not judge it (others as NAME=0)
-- is_counted_only  whether `events` does not list it, as it is nothing that happened
-- counts_as   the kind whose rule counts it; nil if it has a rule NAME=N of its own
-- amount      the key whose values the rule adds up; nil: each message counts once
-- change      the key for the value of message.history's change of this name
-- hides       if a fault may be hidden there: the text behind its count in "may hide faults"
-- scope       "capture": one verdict for the whole capture; "rare": one for each source that has
--             such events; nil: one for each source that can have them
-- about       key that the message type of a source must have; nil for any source with an ID
-- needs_past  whether it can be judged only with a good message and a reliable history
-- needs_values  the same with a message that was decoded
-- needs_time  whether it can be judged only if packets have time stamps
M.LIST = {
  {
    "fault",
    "{flag} {event}{after}",
    keys = "field flag event active",
    about = "alarms",
    needs_past = true,
    needs_values = true,
  },
  { "crc", "bad CRC", hides = "with a bad CRC" },
  { "incomplete", "{what}", keys = "what", hides = "incomplete" },
  {
    "unfinished",
    "cut off by the end of the capture",
    counts_as = "incomplete",
    hides = "cut off by the end of the capture",
  },
  {
    "missing",
    "messages missing by Seq No: {count}",
    keys = "count",
    amount = "count",
    change = "count",
    hides = "missing by Seq No",
    needs_past = true,
  },
  {
    "reboot",
    "controller rebooted (its clock went back by {length} s)",
    change = "length",
    about = "time",
    needs_past = true,
    needs_values = true,
  },
  {
    "stale",
    "controller clock did not advance",
    change = "stale",
    about = "time",
    needs_past = true,
    needs_values = true,
    needs_time = true,
  },
  {
    "jump",
    "controller clock jumped ahead by {length} s",
    keys = "length",
    change = "length",
    about = "time",
    needs_past = true,
    needs_values = true,
    needs_time = true,
  },
  {
    "shared",
    "two controllers appear to send this ID",
    change = "shared",
    about = "time",
    needs_past = true,
    needs_values = true,
  },
  {
    "silence",
    "silent for {length} s",
    keys = "length",
    about = "every",
    needs_past = true,
    needs_time = true,
  },
  {
    "invalid",
    "{field} {code} is not defined{effect}",
    keys = "field value",
    about = "fields",
    needs_values = true,
  },
  {
    "clock",
    "the capture's own clock went back by {back} s",
    keys = "length",
    scope = "capture",
  },
  {
    "dropped",
    "packets lost while capturing: {count}",
    keys = "count",
    amount = "count",
    hides = "lost while capturing",
    scope = "capture",
  },
  { "absent", "no message of it came", scope = "capture" },
  { "copies", "recorded twice", is_optional = true, is_counted_only = true },
  {
    "unknown",
    "{size} bytes, {count} times: {note}",
    keys = "size count like",
    scope = "rare",
  },
  {
    "skipped",
    "{length} bytes of no frame",
    keys = "length",
    hides = "in bytes of no frame",
    scope = "rare",
    is_optional = true,
  },
}

--- The rows by name.
M.BY_NAME = {}
--- The names of the rows that have a rule, in their order.
M.RULES = {}
for _, row in ipairs(M.LIST) do
  row.name, row.text = row[1], row[2]
  M.BY_NAME[row.name] = row
  if not row.counts_as then M.RULES[#M.RULES + 1] = row.name end
end

--- The values of an event that has none.
M.NOTHING = {}

--- Make an event, which statistics list and count.
-- kind    "message" for a good message, else the name of a row
-- frame   number of the packet; time = seconds since the first one
-- source  of message.reader, one table for all its events; for events of a bus, or of the capture,
--         with its bus and name alone, or with nothing
-- values  by the keys of its kind, and by those in its text; of a message see stat.intake
-- message  of a message: { seq, raws = its raw values, nil or false where the catalogue does not
--         decode it }
function M.event(kind, frame, time, source, values, message)
  return {
    kind = kind,
    time = time,
    rel = time, -- the same without the steps back of the capture's clock: see stat.queue
    frame = frame,
    source = source,
    values = values or M.NOTHING,
    seq = message and message.seq,
    raws = message and message.raws,
  }
end

--- Return the seconds between two times of a capture, rounded to the nanosecond, so that a gap of
-- 0.1 s does not exceed 0.1.
function M.span(from, to)
  return math.floor((to - from) * 1e9 + 0.5) / 1e9
end

return M
]=])
module("yapp.stat.measures", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The measures of the rules of `check`, a row each.  The syntax of rules, the list of rules in
-- errors and the verdicts follow.  Pure Lua, 5.2 to 5.5.
--
-- A measure is a function(group, rule, check), which returns the value to judge, its frame, a
-- note, and the value that is farthest outside.  If there is none to judge: nil, nil, why.

local groups = require "yapp.stat.groups"
local joined = require "yapp.base.joined"
local kinds = require "yapp.stat.kinds"
local output = require "yapp.stat.output"

local M = {}

local INFINITE = math.huge
local NO_VALUE = "no good message of it was decoded"
local SAME_SEQ = {
  json = '"Seq No never changes: lost messages do not show"',
  text = "Seq No never changes: lost messages do not show",
  short = "Seq No never changes",
}

local function measure_rate(group)
  local rate = groups.pace(group) or group.count == 1 and 0 or nil
  if not rate then return nil, nil, "no two messages at different times" end
  return rate, group.last_frame
end

local function measure_gap(group, _, check)
  if group.count == 0 then return nil, nil, NO_VALUE end
  local gap, frame = group.gap_max or 0, group.gap_max_frame
  local to_end = kinds.span(group.last + check.states[group.source].ahead, check.ending.now)
  if to_end > gap then gap, frame = to_end, nil end
  return gap, frame or group.last_frame
end

local function measure_range(group, rule)
  local values = group.values[rule.want]
  if values.seen == 0 then return nil, nil, NO_VALUE end
  return values.outside, values.frame, ("of %d values"):format(values.seen), values.worst
end

-- Count the values outside of the range: none may be.
local function want_range(rule, field)
  local want = { field = field, low = rule.low, high = rule.high }
  rule.low, rule.high = -INFINITE, 0
  return want
end

local function measure_numbers(group, rule)
  local values = group.values[rule.want]
  if values.seen > 0 and values.count == 0 then return nil, nil, "all its values are reserved" end
  return measure_range(group, rule)
end

local function want_numbers(rule, field)
  local want = want_range(rule, field)
  want.lets_reserved = true
  return want
end

local function measure_reserved(group, rule)
  local values = group.values[rule.want]
  if values.seen == 0 then return nil, nil, NO_VALUE end
  return (values.seen - values.count) / values.seen, nil, ("of %d values"):format(values.seen)
end

local function measure_spread(_, rule, check)
  local spread = check.spreads[rule.want]
  if not spread.worst then return nil, nil, "no two sources of it have a value at one time" end
  return spread.worst, spread.frame
end

-- name     of the measure
-- text     a rule of it, as errors and docs/statistics.md name it
-- help     its meaning, for people
-- measure  see above
-- bound    the limit that a number is: "low" or "high"; is_count = whether it has no fraction
-- takes_range  whether the limit may be A..B, A.. or ..B; nothing else if there is no bound
-- want     of a field: function(rule, field) -> an entry of Groups:wants
-- needs_past, needs_time, scope  as in rows of kinds

--- MESSAGE.NAME=LIMIT
M.OF_MESSAGE = {
  {
    name = "count",
    text = "MESSAGE.count=N",
    help = "at least N messages came",
    measure = function(group) return group.count, group.last_frame end,
    bound = "low",
    is_count = true,
  },
  {
    name = "rate",
    text = "MESSAGE.rate=A..B",
    help = "the mean rate lies within these Hz",
    measure = measure_rate,
    bound = "low",
    takes_range = true,
    needs_past = true,
    needs_time = true,
  },
  {
    name = "gap",
    text = "MESSAGE.gap=S",
    help = "no gap between two messages is longer than S seconds",
    measure = measure_gap,
    bound = "high",
    needs_past = true,
    needs_time = true,
  },
}

--- MESSAGE.FIELD=LIMIT of the first row, MESSAGE.FIELD.NAME=LIMIT of the others.
M.OF_FIELD = {
  {
    name = "range",
    text = "MESSAGE.FIELD=A..B",
    help = "all values lie within",
    measure = measure_range,
    takes_range = true,
    want = want_range,
  },
  {
    name = "numbers",
    text = "MESSAGE.FIELD.numbers=A..B",
    help = "all values but reserved ones lie within",
    measure = measure_numbers,
    takes_range = true,
    want = want_numbers,
  },
  {
    name = "reserved",
    text = "MESSAGE.FIELD.reserved=X",
    help = "at most this share of the values is reserved, 0.05 for 5 %",
    measure = measure_reserved,
    bound = "high",
    want = function(_, field) return { field = field } end,
  },
  {
    name = "spread",
    text = "MESSAGE.FIELD.spread=X",
    help = "the spread of all sources is never more than X",
    measure = measure_spread,
    bound = "high",
    scope = "capture",
    needs_time = true,
    want = function(_, field) return { field = field, is_spread = true } end,
  },
}

--- All of these rows.
M.LIST = joined(M.OF_MESSAGE, M.OF_FIELD)

-- Kinds of event ----------------------------------------------------------------------------------

-- How many events of a kind there are.
local function count_events(group, rule)
  local kind = rule.kind
  local count = group.counts[kind.name]
  local needed = kind.needs_values and group.decoded or kind.needs_past and group.count
  if needed == 0 then return nil, nil, NO_VALUE end
  return count.seen, count.frame, count.values.note
end

-- The kinds that count in another way, by name.
local of_kind = {}

function of_kind.absent(_, rule, check)
  local names, is_named, others = {}, rule.is_default, 0
  for _, row in ipairs(check.context.settings.sources:list()) do
    if M.is_of(rule, row) and row.message then
      is_named = true
      if check.absent[row] then names[#names + 1] = row.name or output.bus_and_id(row) end
    elseif M.is_of(rule, row) then
      others = others + 1
    end
  end
  if not is_named then return nil, nil, "no source is named with a message: see yapp.sources" end
  local count, more = #names, output.count(others, "name") .. " without a message not judged"
  if others > 0 then names[count + 1] = more end
  return count, nil, table.concat(names, ", ")
end

function of_kind.missing(group, rule, check)
  local seen, frame, note = count_events(group, rule)
  if group.count > 1 and not check.states[group.source].is_numbered then note = SAME_SEQ end
  return seen, frame, note
end

-- Rules -------------------------------------------------------------------------------------------

--- Return whether a rule is about a source, by the name that it gives.
function M.is_of(rule, source)
  return not rule.source or source.name == rule.source
end

--- Measure the subject of a rule; see above.
function M.measure(group, rule, check)
  local kind = rule.kind
  return (kind.measure or of_kind[kind.name] or count_events)(group, rule, check)
end

return M
]=])
module("yapp.stat.menu", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- Wireshark's menus Tools > YAPP and Statistics: the texts of -z yapp,... in windows, and help.
-- Wireshark's API.

local measures = require "yapp.stat.measures"
local options_of = require "yapp.stat.options"
local output = require "yapp.stat.output"

local M = {}

local MAX_FRAMES = 1000 -- in a display filter: more make Wireshark slow

local OLD = "Packets have come since this was read at %s: press Refresh\n\n"

local HELP = [[
YAPP, the packet protocol of Taurus motor controllers, on CAN, CAN FD,
UART, TCP and UDP.

To see                          display filter
every message with a fault      taurus.fault.active
where a fault begins            taurus.fault.raised
where it ends                   taurus.fault.cleared
all frames of these messages    yapp.message.fault
a gap; a controller rebooted    yapp.late || taurus.reboot
bad CRCs                        yapp.crc.status == 0
bytes are missing               yapp.fragment.incomplete
the Start is missing            yapp.fragment.orphan
the capture ends in a message   yapp.unfinished
commands that are ignored       taurus.command.key.invalid
no sensor, or out of range      taurus.value.special
one controller                  yapp.source == "left"

Tools > YAPP
%s
A rule is fault=0, motor.rate=9..11 or motor.dc_voltage=40..55; several
have commas between. Rules about a message:
%s
In a window, Show frames makes a display filter of the frames that
stand in it: a click on one in the packet list leads to it.  On the
command line, without a limit to the width, the same is

    tshark -q -r flight.pcapng -z yapp,faults

All of a flight on one time axis, in the browser, makes the program
yapp-tables, a Python package in the folder tools of the plugin's files:

    pip install "./tools[report]"
    yapp-tables report flight.pcapng --out flight.html

Other IDs than the default, several controllers, names for them:
Edit > Preferences > Protocols > YAPP.
Columns, colours, filter buttons and graphs: the profile YAPP, at the
right of the status bar.  README.md and the folder docs of this plugin's
files have more.
]]

-- Ask for one line.
local function ask(title, label, default, answered)
  new_dialog("YAPP " .. title, answered, { name = label, value = default })
end

-- Return a path for a file of the user's: Lua does not know the folder of the capture.
local function default_path(name)
  return (os.getenv("HOME") or os.getenv("USERPROFILE") or ".") .. "/yapp-" .. name
end

local function show_frames(frames)
  if not frames[1] then
    return report_failure("YAPP: no frame stands in this window")
  end
  local numbers, is_there = {}, {}
  for _, frame in ipairs(frames) do
    if not is_there[frame] then numbers[#numbers + 1] = frame end
    is_there[frame] = true
  end
  local count = math.min(#numbers, MAX_FRAMES)
  set_filter(("frame.number in {%s}"):format(table.concat(numbers, ", ", 1, count)))
  apply_filter()
end

-- [window] = function(), called when packets have come, of the windows that are open.
local notes_of_age = {}

-- A window with a text that can be made anew, copied and saved, and whose frames can be shown.
-- make  function() -> the text, the frames
-- stat  of stat.taps
local function open_window(title, make, stat)
  local window, content, frames = TextWindow.new("YAPP " .. title), nil, nil
  local total, time = 0, "" -- of the reading
  local is_old = true -- whether nothing is to be said: it was said, or the reading goes on
  local function refresh()
    is_old = true
    content, frames = make()
    total, time, is_old = stat.total, os.date("%H:%M:%S"), false
    window:set(content)
  end
  -- Say once that the text is old: a new text makes a window scroll to its beginning.
  notes_of_age[window] = function()
    if is_old or stat.total <= total then return end
    is_old = true
    window:set(OLD:format(time) .. content)
  end
  window:set_atclose(function() notes_of_age[window] = nil end)
  window:add_button("Refresh", refresh)
  window:add_button("Copy", function() copy_to_clipboard(content) end)
  window:add_button("Save", function()
    local path = default_path(title:lower():gsub(" ", "-") .. ".txt")
    ask("Save", "New file", path, function(answer)
      local is_named = answer and answer ~= ""
      local problem = is_named and output.save(answer, content, "give another name")
      if problem then report_failure("YAPP: not written: " .. problem) end
    end)
  end)
  window:add_button("Show frames", function() show_frames(frames) end)
  refresh()
end

-- Hold the help window: Wireshark closes a window that Lua collects, and no button refers to this
-- one.
local help

local function open_help()
  local lines, rules = "", ""
  for _, row in ipairs(options_of.LIST) do
    lines = lines .. ("%-15s%s\n"):format(row.title, row.help)
  end
  for _, row in ipairs(measures.LIST) do
    rules = rules .. ("%-25s%s\n"):format(row.text, row.help)
  end
  help = TextWindow.new("YAPP Help")
  help:set(HELP:format(lines, rules))
end

--- Make the menus.
-- stat     of stat.taps
-- returns  function(text), which opens the window of an argument of -z
--          function(), to be called when packets have come
function M.register(stat)
  -- The statistic runs when its window opens, and again by its button: packets that have come since
  -- count too.
  local function show(argument)
    local row = options_of.BY_NAME[argument:match("^yapp,(%w+)")]
    open_window(row and row.title or "", function() return stat:run(argument) end, stat)
  end

  for _, row in ipairs(options_of.LIST) do
    local argument = "yapp," .. row.name
    local function answered(answer)
      if answer then
        show(answer == "" and argument or argument .. "," .. answer)
      end
    end
    local function action()
      if not row.ask then return show(argument) end
      ask(row.title, row.ask, row.file and default_path(row.file) or "", answered)
    end
    register_menu("YAPP/" .. row.title, action, MENU_TOOLS_UNSORTED)
  end
  register_menu("YAPP/Help", open_help, MENU_TOOLS_UNSORTED)
  -- Wireshark has submenus of plugins in Tools alone: elsewhere it shows a slash as it is.
  local function summary() show("yapp,summary") end
  register_menu("YAPP Summary (more: Tools > YAPP)", summary, MENU_STAT_UNSORTED)
  return show, function()
    for _, note in pairs(notes_of_age) do note() end
  end
end

return M
]=])
module("yapp.stat.names", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The names of the statistics, in the order of stat.options: all that the start of tshark needs of
-- them.  Pure Lua.

return { "summary", "faults", "events", "compare", "csv", "check" }
]=])
module("yapp.stat.options", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The statistics, one row each; and the argument of -z yapp,...: options and rules.  The errors of
-- options, Wireshark's menus and their help, and the tests come from the rows.  Pure Lua.
--
-- A new statistic is a row here and its module.

local check = require "yapp.stat.check"
local csv = require "yapp.stat.csv"
local events = require "yapp.stat.events"
local field_kinds = require "yapp.message.field_kinds"
local input = require "yapp.base.input"
local joined = require "yapp.base.joined"
local kinds = require "yapp.stat.kinds"
local measures = require "yapp.stat.measures"
local summary = require "yapp.stat.summary"

local M = {}

local demand, decimal, find, trim = input.demand, input.decimal, input.find, input.trim

local RULES = table.concat(kinds.RULES, "=N, ") .. "=N"
for _, measure in ipairs(measures.LIST) do RULES = RULES .. ", " .. measure.text end
local NO_RULE = "no rule follows %s: it is for those behind it"
local RANGE = "a range is A..B, A.. or ..B"
local INFINITE = math.huge
local MAX_FILE = 2 ^ 20 -- bytes of a file of rules

-- Rules -------------------------------------------------------------------------------------------
--
-- Functions from here to the rows of the statistics raise errors.

-- Return a number that is not below 0; for a count one without a fraction.
local function limit_of(text, what, is_count)
  local value = decimal(text)
  local is_good = value and value >= 0 and not (is_count and text:find("%D"))
  return demand(is_good and value, "%q is not a %s", text, what)
end

-- An end of a range, which may be left out.
local function end_of(text, none)
  if text == "" then return none end
  return demand(decimal(text), RANGE)
end

-- Return the ends of A..B, A.. or ..B.
local function range_of(text)
  local low, high = text:match("^(.-)%.%.(.*)$")
  demand(low and text ~= "..", RANGE)
  low, high = end_of(low, -INFINITE), end_of(high, INFINITE)
  demand(low <= high, "nothing lies in this range")
  return low, high
end

-- Set the limits of a rule by its measure.
local function set_limits(rule, value)
  local measure = rule.kind
  if measure.takes_range and (not measure.bound or value:find("..", 1, true)) then
    rule.low, rule.high = range_of(value)
  else
    rule[measure.bound] = limit_of(value, measure.name, measure.is_count)
  end
end

-- MESSAGE.FIELD=A..B and MESSAGE.FIELD.spread=X
local function add_field(rule, name, value)
  local message, start, suffix = rule.message, name:match("^(.*)%.(%l+)$")
  local plain = measures.OF_FIELD[1]
  rule.kind = suffix ~= plain.name and find(measures.OF_FIELD, suffix) or plain
  if rule.kind ~= plain then name = start end
  local field, names = find(joined(message.fields, message.generated), name)
  demand(field, "%s has no field %q, but %s", message.name, name, names)
  demand(not field_kinds.BY_NAME[field.kind].is_text,
    "%s.%s is a text, which has no range", message.name, field.name)
  demand(not (rule.source and rule.kind.scope == "capture"),
    "a %s is of all sources, not of one", rule.kind.name)
  set_limits(rule, value)
  rule.want = rule.kind.want(rule, field)
end

-- Return the name of a rule MESSAGE.NAME=..., and its measure, nil for a field.  A field of the
-- user's may have the name of a measure: then NAME.value is the field, NAME.messages the measure.
local function tell_apart(message, name)
  local short, kind = name:match("^(.*)%.(%l+)$")
  if kind == "value" then return short end
  local measure = find(measures.OF_MESSAGE, short)
  if kind == "messages" and measure then return short, measure end
  measure = find(measures.OF_MESSAGE, name)
  demand(not measure or not find(joined(message.fields, message.generated), name),
    "%s has a field %s: write %s.value for it, %s.messages for the messages", message.name, name,
    name, name)
  return name, measure
end

-- "fault=0", "motor.rate=9.5", "motor.dc_voltage=40..55": { text, source,
--   kind       a row of kinds or of measures
--   low, high  the limits of the value to judge
--   message    compiled, of MESSAGE.
--   want       an entry of Groups:wants, nil for a rule about no field }
local function read_rule(text, catalogue, source)
  local name, value = text:match("^([^=]*)=(.*)$")
  local kind = kinds.BY_NAME[name]
  local rule = { text = text, source = source, kind = kind, low = -INFINITE, high = INFINITE }
  if kind and not kind.counts_as then
    rule.high = limit_of(value, "number of messages", true)
    return rule
  end
  local message_name, rest = (name or ""):match("^([^.]+)%.(.+)$")
  demand(message_name, "a rule is one of %s; options are %s, filter=EXPRESSION", RULES,
    M.BY_NAME.check.options)
  local message, names = find(catalogue.messages, message_name)
  rule.message = demand(message, "there is no message %q, but %s", message_name, names)
  rest, rule.kind = tell_apart(message, rest)
  if rule.kind then set_limits(rule, value) else add_field(rule, rest, value) end
  return rule
end

-- Options -----------------------------------------------------------------------------------------

-- Call a function of a row of LIST.  If it raises a text, note it as a problem of this part.
local function try(options, part, call, catalogue)
  local ok, why = pcall(call, options, part, catalogue)
  if ok then return end
  if part == "" then part = "an empty option" end
  table.insert(options.problems, ("%s%s: %s"):format(options.line, part, why))
end

-- Return a part without the blanks around the first of these signs.
local function without_blanks(part, sign)
  local from, to = part:find(sign, 1, true)
  return from and trim(part:sub(1, from - 1)) .. sign .. trim(part:sub(to + 1)) or part
end

local read_check

-- The rules of a file, one a line.  A # begins a comment, unless it stands in the name of a source.
local function read_file(options, path, catalogue)
  demand(options.line == "", "a file of rules names no other")
  local file, problem = io.open(path, "rb")
  demand(file, "%s", problem)
  local text = file:read(MAX_FILE) or ""
  file:close()
  demand(#text < MAX_FILE, "the file is too long")
  local count, number_of_line = #options.rules + #options.problems, 0
  local source = options.source -- for the rules behind the file
  for line in (text:gsub("^\239\187\191", "") .. "\n"):gmatch("(.-)\r?\n") do
    number_of_line = number_of_line + 1
    local part = trim((" " .. line):gsub("%s#.*", ""))
    if not part:find("^source%s*=") then part = trim(part:gsub("#.*", "")) end
    options.line = ("%s:%d: "):format(path, number_of_line)
    if part ~= "" then try(options, part, read_check, catalogue) end
  end
  options.line, options.source = "", source
  demand(#options.rules + #options.problems > count, "there is no rule in it")
  local unused = options.unused
  options.unused = nil -- a rule behind the file would not be about this source
  demand(not unused, NO_RULE, unused)
end

function read_check(options, part, catalogue)
  part = without_blanks(without_blanks(part, "="), "..")
  local name, value = part:match("^(%w+)=(.*)$")
  if name == "junit" or name == "source" or name == "rules" then
    demand(value ~= "", "it is empty")
    if name == "source" then
      demand(not options.unused, NO_RULE, options.unused)
      options.unused = part
    end
    if name == "rules" then return read_file(options, value, catalogue) end
    options[name] = value
  else
    options.unused = nil
    table.insert(options.rules, read_rule(part, catalogue, options.source))
    options.looks_for_faults = options.looks_for_faults or name == "fault"
    options.judges_unknown = options.judges_unknown or name == "unknown"
  end
end

local function finish_check(options, _, catalogue)
  local rules = options.rules
  if rules[1] or options.problems[1] then
    -- No rule can check a message that was not decoded.
    if not options.judges_unknown then
      rules[#rules + 1] = read_rule("unknown=0", catalogue)
    end
    demand(not options.unused, NO_RULE, "it")
    return
  end
  options.looks_for_faults = true
  for _, kind in ipairs(kinds.RULES) do
    if not kinds.BY_NAME[kind].is_optional then
      local rule = read_rule(kind .. "=0", catalogue, options.source)
      rule.is_default, rules[#rules + 1] = true, rule
    end
  end
end

local function refuse(options)
  demand(false, "the options of %s are %s, filter=EXPRESSION", options.what, options.row.options)
end

local function read_csv(options, part, catalogue)
  if not options.folder then
    options.folder = part
    return
  end
  if options.folder ~= "-" or options.chosen then refuse(options) end
  local message, names = find(catalogue.messages, part)
  options.chosen = demand(message, "no such message; known messages: %s", names or "none")
end

local function finish_csv(options)
  local folder, chosen = options.folder or "", options.chosen
  demand(folder ~= "" and (folder ~= "-" or chosen), "it is csv,FOLDER or csv,-,MESSAGE")
  demand(not (chosen and options.json), "csv,- prints a table; json is for csv,FOLDER")
end

-- The statistics ----------------------------------------------------------------------------------

-- name     behind -z yapp,
-- title    in menus
-- new      function(options, context), makes it: see stat.derive
-- columns  of output.columns
-- options  the words besides filter=EXPRESSION: M.read knows the words without "=" by this text
-- read     function(options, part, catalogue), reads other options; nil if there are none
-- finish   the same, checks all options at the end; nil for no check
-- help     its meaning, for people
-- ask      the question of a menu; the answer follows the name
-- file     the name of a new file that a menu suggests
-- table_only  whether its output has no room for notes
-- looks_for_faults  whether it must say which messages may hide a fault, as it does not list them
M.LIST = {
  {
    name = "summary",
    title = "Summary",
    new = summary.new,
    columns = summary.COLUMNS,
    options = "json",
    help = "of each controller: rate, gaps, losses, its values",
  },
  {
    name = "faults",
    title = "Faults",
    new = events.new,
    columns = events.COLUMNS.faults,
    options = "json",
    help = "when each fault rose and fell",
    looks_for_faults = true,
  },
  {
    name = "events",
    title = "Events",
    new = events.new,
    columns = events.COLUMNS.events,
    options = "json",
    help = "these, reboots, silences, bad CRCs, losses, in order",
  },
  {
    name = "compare",
    title = "Compare",
    new = summary.compare,
    columns = summary.COMPARED,
    options = "json",
    help = "the values of all controllers beside each other",
  },
  {
    name = "csv",
    title = "Export tables",
    new = csv.new,
    columns = csv.COLUMNS,
    options = "replace, all, json",
    read = read_csv,
    finish = finish_csv,
    help = "a CSV for each message, in a new folder",
    ask = "New folder",
    file = "tables",
    table_only = true,
  },
  {
    name = "check",
    title = "Check",
    new = check.new,
    columns = check.COLUMNS,
    options = "json, junit=FILE, source=NAME, rules=FILE",
    read = read_check,
    finish = finish_check,
    help = "whether all is well, or rules hold",
    ask = "Rules (empty: check everything)",
  },
}

--- The rows by name.
M.BY_NAME = {}
for _, row in ipairs(M.LIST) do M.BY_NAME[row.name] = row end

-- words  the options without "="
local function read_part(options, part, words, catalogue)
  -- A message may have the name of an option: csv,-,all prints the message all.
  local is_message = options.folder == "-" and not options.chosen and
    find(catalogue.messages, part)
  if words[part] and not is_message then
    options[part] = true
  else
    try(options, part, options.row.read or refuse, catalogue)
  end
end

--- Read the argument of -z.
-- text       "yapp,check,fault=0,motor.rate=9,filter=can.bus_id == 1, or so"
-- catalogue  compiled
-- returns    { what =, row = of LIST, filter = or nil,
--            json = true and other words of the row's options, if they were given,
--            statistics = LIST; folder, chosen = of csv; rules, junit = of check;
--            looks_for_faults = whether a rule is about faults; problems = list of texts, each
--            names its option }
function M.read(text, catalogue)
  local head, filter = text:match("^(.-),%s*filter%s*=(.*)$") -- a display filter, commas and all
  local what, rest = (head or text):match("^yapp%s*,([^,]*)(.*)$")
  what = trim(what or "")
  local row = M.BY_NAME[what]
  local options = {
    what = what,
    row = row,
    statistics = M.LIST,
    filter = filter,
    rules = {},
    problems = {},
    line = "", -- in a file of rules "FILE:7: "
  }
  if not row then
    local _, names = find(M.LIST)
    options.problems[1] = ("%s: it is yapp,%s"):format(text, (names:gsub(", ", " or yapp,")))
    return options
  end
  local words = input.set((row.options:gsub("%w+=%w+", ""):gsub(",", "")))
  for part in rest:gmatch(",([^,]*)") do
    read_part(options, trim(part), words, catalogue)
  end
  if row.finish then try(options, options.unused or what, row.finish, catalogue) end
  if filter and not filter:find("%S") then
    table.insert(options.problems, "filter=: the display filter is missing")
  end
  return options
end

return M
]=])
module("yapp.stat.output", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The output of statistics: JSON lines, tables for people, and files, which exist only if
-- they are complete; and the exit codes.  Pure Lua, 5.2 to 5.5.

local utf8 = require "yapp.base.utf8"

local M = {}

M.EXIT_OK = 0
M.EXIT_FAILED = 20 -- a rule does not hold
M.EXIT_UNDECIDED = 21 -- something could not be judged, said or written

local format = string.format

-- JSON ----------------------------------------------------------------------------------------

-- Write characters that are not printable as \xNN: JSON must be UTF-8.
local function text_value(text)
  return '"' .. utf8.printable(text):gsub('["\\]', "\\%0") .. '"'
end

local function is_integer(value)
  return value % 1 == 0 and math.abs(value) < 2 ^ 53
end

-- Return the shortest text that reads back as the same number; null for NaN and infinity.
local function number_value(value)
  if value - value ~= 0 then return "null" end
  if is_integer(value) then return format("%d", value) end
  local shown = format("%.15g", value)
  return tonumber(shown) == value and shown or format("%.17g", value)
end

--- The JSON of a value: string, number, nil (null), or { json = JSON already }.
function M.value(value)
  local kind = type(value)
  if kind == "number" then return number_value(value) end
  if kind == "table" then return value.json end
  return value and text_value(value) or "null"
end

--- An object of these keys, in this order, with the values that a table has under them; a missing
-- value is null.
function M.object(keys, values)
  local texts = {}
  for i, key in ipairs(keys) do
    texts[i] = text_value(key) .. ":" .. M.value(values[key])
  end
  return { json = "{" .. table.concat(texts, ",") .. "}" }
end

--- A list of objects.
function M.list(objects)
  local texts = {}
  for i, object in ipairs(objects) do
    texts[i] = object.json
  end
  return { json = "[" .. table.concat(texts, ",") .. "]" }
end

--- A time of the capture with nine digits, as text.
-- seconds, nanoseconds  integers, nanoseconds 0 .. 999,999,999
function M.time_text(seconds, nanoseconds)
  if seconds < 0 and nanoseconds > 0 then -- -1 s plus 9e8 ns is -0.1 s
    return format("-%d.%09d", -seconds - 1, 1000000000 - nanoseconds)
  end
  return format("%d.%09d", seconds, nanoseconds)
end

-- Values ----------------------------------------------------------------------------------------
--
-- A value of a row: a text, a number, nil, or { json, text, short } where people read something
-- else than JSON has, or nothing (no text); short is the text for a window, if that is
-- shorter.

--- Return a time of the capture; people read it in UTC, to the microsecond.
-- seconds, nanoseconds  since 1970
function M.time(seconds, nanoseconds)
  local ok, date = pcall(os.date, "!%Y-%m-%d %H:%M:%S", seconds) -- on Windows from 1970 to 3000
  local shown = ok and date or format("%d", seconds)
  return {
    json = M.time_text(seconds, nanoseconds),
    text = format("%s.%06d", shown, math.floor(nanoseconds / 1000)),
  }
end

--- Return a span of seconds; nil for nil.
function M.seconds(value)
  if not value then return nil end
  return {
    json = format("%.9f", value),
    text = format("%.6f", value),
    short = format("%.3f", value),
  }
end

--- Return the text of a value for people: of a fraction six digits, in a window five.  NaN stands
-- for a reserved value.
-- is_short  whether in a window
function M.text(value, is_short)
  if type(value) == "table" then value = is_short and value.short or value.text end
  if value ~= value then return "reserved" end
  if type(value) == "number" then
    return format(is_integer(value) and "%d" or is_short and "%.5g" or "%.6g", value)
  end
  return value or ""
end

--- Return a count of things: "1 message", "2 messages".
function M.count(number, thing)
  return format("%d %s%s", number, thing, number == 1 and "" or "s")
end

--- Return where a source is: its bus and ID, "can0 0x210".
function M.bus_and_id(source)
  local id = source.id and format("0x%x", source.id)
  return source.bus and id and source.bus .. " " .. id or source.bus or id or ""
end

--- Add the columns of a source to a row of values; return the row.
function M.row(source, row)
  row.bus, row.source = source.bus, source.name
  row.who = source.name or M.bus_and_id(source) -- bus, ID and name in one column
  if not source.id then return row end
  local message = source.message or { title = "unknown" }
  row.id = { json = format("%d", source.id), text = format("0x%x", source.id) }
  row.message = { json = M.value(message.name), text = message.title }
  return row
end

-- Rows ------------------------------------------------------------------------------------------

--- A list of the words of a text.
function M.words(text)
  local list = {}
  for word in text:gmatch("%S+") do
    list[#list + 1] = word
  end
  return list
end

-- Columns of several statistics: their rows name them by the key.
local COMMON = {
  time = {
    type = "time",
    title = "time (UTC)",
    help = "when it happened, UTC; null where nothing came",
  },
  rel = { title = "since start/s", short = "at/s" },
  frame = { type = "integer", help = "the packet that shows it" },
  who = { title = "source" },
  bus = {
    type = "string",
    help = "the bus or line; null where the capture names none",
  },
  id = {
    type = "id",
    title = "ID",
    help = "the message ID; null where the event is of the whole capture",
  },
  source = {
    type = "string",
    help = "the name that `yapp.sources` gives to the ID; null without a name",
  },
  message = {
    type = "string",
    help = "the message's name in the catalogue; null if the catalogue has none",
  },
  field = { type = "string", help = "the flags or the enum concerned" },
  flag = { type = "string", help = "of a fault: the flag" },
  event = {
    type = "string",
    help = "of a fault: `raised`, `cleared`, or `active` at the end",
  },
  active = {
    type = "seconds",
    unit = "s",
    help = "of a fault: how long it was there; null for `raised`",
  },
}

-- Return the heading of a column.
local function title_of(column)
  local key, unit = column.key, column.unit
  return column.title or unit and key .. "/" .. unit or key
end

--- Read the columns of a table, a row each, in their order.
-- rows     list of { key,
--            where  the places that show it: "json", "text", "window", or several of them
--            type   in JSON: "integer", "id", "number", "seconds", "time" (seconds since 1970),
--                   "boolean", "string" (one of a few), "text", "values" (an object by field) or
--                   "list"; nil if JSON has it in no line
--            unit   of a number, or nil
--            title  above it, nil for the key and the unit; short = the same in a window
--            help   its meaning: for fields.json and the pages that follow it };
--          COMMON has the rest
-- returns  { json = list of keys, text, window = lists of { key, title }, all = list of all rows }
function M.columns(rows)
  local columns = { json = {}, text = {}, window = {}, all = {} }
  for i, row in ipairs(rows) do
    local column = { key = row[1] }
    for name, value in pairs(COMMON[column.key] or {}) do column[name] = value end
    for name, value in pairs(row) do column[name] = value end
    column.title = title_of(column)
    columns.all[i] = column
    for place in column.where:gmatch("%l+") do
      local is_short = place == "window" and column.short
      local shown = { key = column.key, title = is_short and column.short or column.title }
      table.insert(columns[place], place == "json" and column.key or shown)
    end
  end
  return columns
end

local DESCRIBED = M.words("name type unit title help")

--- Return the columns of JSON as fields.json has them.
-- columns  of M.columns
function M.describe(columns)
  local list = {}
  for _, column in ipairs(columns.all) do
    if column.type then
      local about = { name = column.key, unit = column.unit, help = column.help }
      about.type, about.title = column.type, column.title
      list[#list + 1] = M.object(DESCRIBED, about)
    end
  end
  return M.list(list)
end

-- Return the width of a text: in characters, not bytes.
local function width_of(text)
  return select(2, text:gsub("[^\128-\191]", ""))
end

-- Make room in a column for a text.
local function fit(column, text)
  column.width = math.max(column.width, width_of(text))
  column.is_number = column.is_number and not text:find("[^%d.e+-]")
  column.is_empty = column.is_empty and text == ""
end

-- Return a line of texts: of one width in each column, numbers to the right, without columns where
-- no row has anything.
local function line_of(columns, texts)
  local cells = {}
  for i, column in ipairs(columns) do
    local text = texts[i]
    local blanks = (" "):rep(column.width - width_of(text))
    local cell = column.is_number and blanks .. text or text .. blanks
    if not column.is_empty then cells[#cells + 1] = cell end
  end
  return (table.concat(cells, "  "):gsub("%s*$", "\n", 1))
end

--- Sort a list.  Entries with equal values keep their order.
-- order_of  function(one) -> the values to sort by
function M.sort(list, order_of)
  local orders = {}
  for i, one in ipairs(list) do
    orders[one] = { i, order_of(one) }
  end
  table.sort(list, function(a, b)
    local left, right = orders[a], orders[b]
    for i = 2, #left do
      if left[i] ~= right[i] then return left[i] < right[i] end
    end
    return left[1] < right[1]
  end)
end

local function itself(row)
  return row
end

-- Return the texts in the columns of a row.
local function texts_of(columns, row, is_short)
  local texts = {}
  for i, column in ipairs(columns) do
    texts[i] = M.text(row[column.key], is_short)
  end
  return texts
end

--- Print a table with aligned columns, a line a row.
-- context, columns, rows, row_of  see M.print
function M.table(context, columns, rows, row_of)
  local frames, cells, titles = context.frames, {}, {}
  row_of = row_of or itself
  for i, column in ipairs(frames and columns.window or columns.text) do
    titles[i] = column.title
    cells[i] = {
      key = column.key,
      width = width_of(column.title),
      is_number = true,
      is_empty = true,
    }
  end
  for _, one in ipairs(rows) do
    local row = row_of(one)
    for i, text in ipairs(texts_of(cells, row, frames)) do fit(cells[i], text) end
    if frames then frames[#frames + 1] = row.frame or row.gap_max_frame end
  end
  context.out(line_of(cells, titles))
  for _, one in ipairs(rows) do
    context.out(line_of(cells, texts_of(cells, row_of(one), frames)))
  end
end

--- Print rows: for people under a title and the notes, or as a JSON object a line.
-- context  { out = function(text), json = whether so, frames = in a window a list that gets the
--          frames of the rows, else nil }
-- columns  of M.columns; a row may have keys of its own for its line of JSON, row.keys
-- rows     tables by key
-- notes    a list of texts
-- row_of   function(one) -> a row, if rows are made only when they are printed: many take memory
function M.print(context, title, columns, rows, notes, row_of)
  local out = context.out
  if context.json then
    for _, one in ipairs(rows) do
      local row = (row_of or itself)(one)
      out(M.object(row.keys or columns.json, row).json .. "\n")
    end
    return
  end
  out(title .. "\n")
  for _, note in ipairs(notes) do
    out(note .. "\n")
  end
  if not rows[1] then return end
  out("\n")
  M.table(context, columns, rows, row_of)
end

-- Files ---------------------------------------------------------------------------------------

local File = {}
File.__index = File

--- Begin a file, under another name until it is complete.  A device is written directly, as a
-- rename would replace the device by a file.
-- advice   the error if the file exists, which ends with the remedy; nil to overwrite it
-- returns  the file, with File:write(text); nil and why not
function M.create(path, advice)
  local there = advice and io.open(path, "rb")
  if there then
    there:close()
    return nil, ("%s is there; %s"):format(path, advice)
  end
  local aside = path:find("^/dev/") and path or path .. ".part"
  local handle, problem = io.open(aside, "wb")
  if not handle then return nil, problem end
  handle:setvbuf("full", 65536)
  return setmetatable({ path = path, aside = aside, handle = handle }, File)
end

function File:write(text)
  local ok, problem = self.handle:write(text)
  if not ok then self.problem = problem end
end

--- Close files and give them their names.  If one could not be written, remove all of them.
-- problem  an error of before, nil for none
-- returns  an error, nil for none
function M.finish(list, problem)
  local function note(file, _, why)
    if why then problem = problem or file.path .. ": " .. why end
  end
  for _, file in ipairs(list) do
    note(file, nil, file.problem)
    note(file, file.handle:close())
  end
  for _, file in ipairs(list) do
    local aside, path = file.aside, file.path
    if problem and aside ~= path then
      os.remove(aside)
    elseif aside ~= path and not os.rename(aside, path) then
      os.remove(path) -- on Windows a rename does not replace a file
      note(file, os.rename(aside, path))
    end
  end
  return problem
end

--- Write a file that holds a text.
-- advice   as for M.create
-- returns  an error, nil for none
function M.save(path, text, advice)
  local file, problem = M.create(path, advice)
  if not file then return problem end
  file:write(text)
  return M.finish { file }
end

return M
]=])
module("yapp.stat.queue", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- From the dissectors to the statistics: hands on events in the order of the capture, to each
-- statistic those that its filter lets count.  Knows exact times.  Pure Lua, 5.2 to 5.5.
--
-- A packet is dissected, and its events are offered.  Then the taps run: a filter's says that the
-- packet matches, and the one that sees all packets says that it is there.  Nothing promises their
-- order, so the events of a packet are handed on when the next packet comes.

local derive = require "yapp.stat.derive"
local joined = require "yapp.base.joined"
local kinds = require "yapp.stat.kinds"
local output = require "yapp.stat.output"

local M = {}

local MAX_LOSSES = 1000 -- look through the waiting losses when they are more, see hand_on_losses
local SEARCH_PREFERENCES = "yapp.user_dlt, tcp.try_heuristic_first, udp.try_heuristic_first, " ..
  "-d tcp.port==PORT,yapp_serial, in Wireshark also yapp.search_all" -- tshark searches all
local MAX_STEP = 0.001 -- seconds; several interfaces make the clock go back by up to this
-- Clocks that begin anew at 0: of 2^32 microseconds, of a day.  What is missing to their end is the
-- time from one packet to the next.
local WRAPS, MAX_REST = { 2 ^ 32 / 1e6, 86400 }, 10 -- seconds
local MAX_APART = 0.2 -- seconds between the packets of recorders whose stamps alternate
local MAX_FALLS = 4 -- of as many recorders, and one more, the stamps may alternate
local NO_TIMES = "packets of this capture have no time stamps"
-- As candump -H writes them for an adapter that has no clock.
local EQUAL_TIMES = "all packets of this capture have the same time stamp"

local floor = math.floor

local Queue = {}
Queue.__index = Queue

--- Make a queue for a run over the capture.
-- settings  see stat.taps
-- hint      a text for statistics without a filter, or nil
function M.new(settings, hint)
  local self = setmetatable({ settings = settings, hint = hint, derivers = {} }, Queue)
  self:reset()
  return self
end

--- Forget all events and packets, as all packets will be revisited.
function Queue:reset()
  self.offered, self.number, self.visited = {}, nil, nil -- of the packet that is dissected
  self.waiting = {}
  self.last = nil -- time of the latest packet
  self.latest = 0 -- its number
  self.has_progress = false -- whether it differs from the packet's before
  self.packets = 0
  self.fallen = 0 -- sum of the seconds that the capture's clock went back, see note_step
  self.falls = {} -- these steps, but those from which it returned; the latest first
  self.clocks = {} -- by source, see time_of
  self:begins(0, 0, 0) -- until a time is known, if ever
  self.losses, self.max_losses = {}, MAX_LOSSES -- events that wait, see hand_on_losses
  self.seen = {} -- [value that all losses of one message share] = true once one was handed on
  self.undissected = {} -- events, see Queue:add_undissected: they count if messages are dissected
  self.has_messages = false
  self.is_direct = false
end

--- Add a statistic, see stat.derive.
-- options  of stat.options
-- returns  its deriver, with the table `matched` if it has a filter
function Queue:add(statistic, options)
  local deriver = derive.new(self.settings, statistic, options)
  self.derivers[#self.derivers + 1] = deriver
  return deriver
end

-- Return the seconds to add for a step back of a clock: if it began anew, the time went on.
--   4294.900, 0.010   4294.967296: 0.077 s went by
--   10.0, 3.8         6.2
local function fall_of(step)
  for _, wrap in ipairs(WRAPS) do
    if wrap >= step and wrap - step < MAX_REST then return wrap end
  end
  return step
end

-- Return the time of an event without the steps back of its source's own stamps: the stamps of
-- other sources may be those of another recorder.
local function time_of(self, event)
  local clock = self.clocks[event.source]
  if not clock then
    clock = { fallen = self.fallen, latest = nil } -- seconds its stamps went back, its latest time
    self.clocks[event.source] = clock
  end
  local now = event.time + clock.fallen
  if event.kind ~= "message" and event.kind ~= "crc" then return now end -- a loss may come late
  local step = kinds.span(now, clock.latest or now)
  if step > MAX_STEP then
    local fall = fall_of(step)
    clock.fallen, now = clock.fallen + fall, now + fall
  end
  clock.latest = now
  return now
end

-- Note a step of the capture's clock.  If the stamps of several recorders alternate, it returns
-- from where it fell:
--   10.0, 3.8, 10.1, 3.9        falls by 6.2, returns, falls: 6.2 s in all, not 12.4
--   10.0, 3.8, 3.9 ... 9.9      fell by 6.2 for good
local function note_step(self, step)
  local falls, total = self.falls, 0
  if step < -MAX_STEP then
    local fall = fall_of(-step)
    self.fallen = self.fallen + fall
    table.insert(falls, 1, fall)
    falls[MAX_FALLS + 1] = nil
    return
  end
  for i = 1, step > MAX_STEP and #falls or 0 do
    total = total + falls[i]
    local excess = step - total
    if excess >= -total / 4 and excess <= math.max(total / 4, MAX_APART) then
      self.fallen = self.fallen - total
      for _ = 1, i do table.remove(falls, 1) end
      return
    end
  end
end

local function hand_on(self, event)
  local now = time_of(self, event)
  event.rel = now
  if event.source.id then self.has_messages = true end
  local capture_now = event.time + self.fallen
  for _, deriver in ipairs(self.derivers) do
    deriver:take(event, now, capture_now)
  end
end

-- Hand on the losses that were not withdrawn: each lost message once.  Those that may still be
-- withdrawn wait.  They are few, so all losses wait until they are twice as many: it costs little
-- to look at them then.
-- is_end  whether none of them will be withdrawn any more
local function hand_on_losses(self, is_end)
  local losses, seen = self.losses, self.seen
  self.losses = {}
  for _, event in ipairs(losses) do
    local lost, anomaly = event.values.lost, event.values.anomaly
    if anomaly.is_open and not is_end then
      self.losses[#self.losses + 1] = event
    elseif not (anomaly.is_withdrawn or seen[lost or false]) then
      if lost then seen[lost] = true end
      event.values = event.values.shown
      hand_on(self, event)
    end
  end
  self.max_losses = math.max(MAX_LOSSES, 2 * #self.losses)
end

local function take(self, event)
  if event.values.anomaly then
    self.losses[#self.losses + 1] = event
    if #self.losses > self.max_losses then hand_on_losses(self) end
  else
    hand_on(self, event)
  end
end

local function flush(self)
  local waiting = self.waiting
  if not waiting[1] then return end
  for i, event in ipairs(waiting) do
    waiting[i] = nil
    take(self, event)
  end
end

--- Take an event of the packet that is dissected, or of an earlier one.
-- visited  of the packet: tshark -2 dissects all packets before the first tap runs
function Queue:offer(event, visited)
  -- An event of an earlier packet is of a conversation that was unknown when that came.
  if self.is_direct or event.frame <= self.latest then
    flush(self)
    return take(self, event)
  end
  if event.frame ~= self.number or visited ~= self.visited then
    self.number, self.visited, self.offered = event.frame, visited, {}
  end
  self.offered[#self.offered + 1] = event
end

--- Keep an `undissected` event until the end.
function Queue:add_undissected(event)
  self.undissected[#self.undissected + 1] = event
end

--- Say when the first packet was captured.
-- seconds, nanoseconds  integers
-- rel                   the packet's time since the first one: not 0 if a filter rejected the first
function Queue:begins(seconds, nanoseconds, rel)
  self.first = { seconds = seconds, nanoseconds = nanoseconds, rel = rel }
end

--- Return a time of the capture as seconds since 1970 and nanoseconds; exact for captures of up to
-- 48 days, as a double has 2^22 s to half a nanosecond.
-- rel  seconds since the first packet
function Queue:clock(rel)
  local first = self.first
  local since = rel - first.rel
  local nanoseconds = first.nanoseconds + floor(since % 1 * 1e9 + 0.5)
  local seconds = first.seconds + floor(since) + floor(nanoseconds / 1e9)
  return seconds, nanoseconds % 1e9
end

--- Hand on events at once from now on, if all statistics are tables: no other can do without the
-- taps of packets.  This saves a tenth of csv's time.  Call it from a tap, when no other packet
-- still waits for its taps.
-- returns  whether events are handed on at once
function Queue:go_direct()
  for _, deriver in ipairs(self.derivers) do
    if deriver.matched or not deriver.options.row.table_only then
      return false
    end
  end
  self.is_direct = true
  return true
end

--- Say that a packet of any kind has been dissected.
-- number, rel  of the packet; rel = seconds since the first one.  With tshark -2 -R the number of a
--              packet that the first pass rejected is another's in the second, with another time
-- lacks_clock  whether rel is the time of a controller: to go back is no event then
function Queue:packet(number, rel, lacks_clock)
  flush(self)
  local step = self.last and kinds.span(self.last, rel) or 0
  self.last, self.latest, self.packets = rel, number, self.packets + 1
  self.has_progress = self.has_progress or step ~= 0
  if not lacks_clock then note_step(self, step) end
  if step < -MAX_STEP and not lacks_clock then
    local values = { length = output.seconds(step), back = output.seconds(-step) }
    local event = kinds.event("clock", number, rel, {}, values)
    event.rel = rel + self.fallen
    for _, deriver in ipairs(self.derivers) do deriver:add(event) end
  end
  if number == self.number and self.offered[#self.offered].time == rel then
    self.waiting, self.number = self.offered, nil
  end
end

-- The end -----------------------------------------------------------------------------------------

-- Return why a capture has no message; nil if it has one.
local function nothing_found(self, capture)
  local extended = capture.extended
  if self.has_messages then return nil end
  if extended > 0 then
    local text = "no YAPP message found; %s not dissected: see yapp.motor_ids, yapp.all_extended"
    local frames = output.count(extended, "extended CAN frame")
    return text:format(frames .. (extended == 1 and " was" or " were"))
  end
  if self.packets == 0 then
    return "no YAPP message found: the capture has no packets, or -R removed all of them"
  end
  local packets = output.count(self.packets, "packet")
  if capture.can > 0 and capture.can == self.packets then
    return ("no YAPP message found in %s: no CAN data frame has a 29-bit id"):format(packets)
  end
  local options = table.concat(capture.options or {}, " or ")
  local advice = options ~= "" and "try " .. options or "see " .. SEARCH_PREFERENCES
  return ("no YAPP message found in %s: %s"):format(packets, advice)
end

-- Return the traces of YAPP in other packets: a list of texts.
local function unread_packets(self, capture)
  if not (self.has_messages and capture.certain and capture.certain[1]) then return {} end
  return { "YAPP in other packets was not decoded: try " .. table.concat(capture.certain, " ") }
end

-- Return why times of packets mean nothing; nil if they mean something.
local function lacks_times(self, capture)
  if capture.lacks_times then return NO_TIMES end
  return self.packets > 1 and not self.has_progress and EQUAL_TIMES or nil
end

--- Say that all packets have come: events are handed on at once.
function Queue:end_packets()
  flush(self)
  self.is_direct = true
end

--- End: all packets have come.
-- capture  { unfinished = events of the messages that it ends before, drops = of host.buses,
--          options = list of tshark's options that may decode what was not found, or nil; certain =
--          those of them that certainly decode YAPP; notes = list of texts to say besides, or nil;
--          lacks_times = whether packets have no time stamps, extended = number of extended CAN
--          frames that were not dissected, can = number of all such CAN frames, problems = list of
--          texts: why not all was read, unread = the same in short if
--          packets were left out, nil if none }
-- returns  the exit code, and a list of texts to say
function Queue:finish(capture)
  flush(self)
  hand_on_losses(self, true)
  for _, event in ipairs(capture.unfinished) do
    hand_on(self, event)
  end
  local seconds, nanoseconds = self:clock(0)
  local ending = {
    rel = self.last, -- of the last packet of any kind, nil where there was none
    now = self.last and self.last + self.fallen,
    begin = seconds + nanoseconds / 1e9, -- of the first packet
    reason = nothing_found(self, capture), -- why no message was found, nil if one was
    lacks_times = lacks_times(self, capture),
    -- Wishes of the user that were not met, and why not all was read: texts.
    problems = joined(self.settings.problems, capture.problems, unread_packets(self, capture)),
    unread = capture.unread, -- the same in short if packets were left out
    drops = capture.drops,
    undissected = self.undissected,
    hint = self.hint,
  }
  local code, texts, said = output.EXIT_OK, {}, {}
  local function say(text)
    if text and not said[text] then
      said[text], texts[#texts + 1] = true, text
    end
  end
  for _, deriver in ipairs(self.derivers) do
    local worse, text, notes = deriver:finish(ending)
    if worse and (code == output.EXIT_OK or worse < code) then code = worse end
    say(text)
    for _, note in ipairs(notes) do say(note) end
  end
  for _, note in ipairs(capture.notes or {}) do say(note) end
  return code, texts
end

return M
]=])
module("yapp.stat.summary", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,summary: each source with its rate, gaps, losses, and the range of its values; and
-- -z yapp,compare: the values of all sources of a message beside each other.  Pure Lua, 5.2 to 5.5.
--
-- Good messages are counted and make rates, gaps and values.  Messages with a bad CRC and
-- incomplete ones are counted separately.

local groups = require "yapp.stat.groups"
local output = require "yapp.stat.output"

local M = {}

-- Besides, `kind` is the kind of event that a column counts.
local COLUMNS = output.columns {
  { "who", where = "window" },
  { "bus", where = "json text" },
  { "id", where = "json text" },
  { "source", where = "json text" },
  { "message", where = "json text window" },
  { "count", type = "integer", where = "json text window", help = "good messages" },
  { "rate", type = "number", unit = "Hz", where = "json text window",
    help = "(count - 1) / (last - first)" },
  { "gap_min", type = "seconds", unit = "s", where = "json text", title = "gap/s min",
    help = "the shortest time between two messages" },
  { "gap_mean", type = "seconds", unit = "s", where = "json text", title = "mean",
    help = "the mean" },
  { "gap_max", type = "seconds", unit = "s", where = "json text window", title = "max",
    short = "gap/s", help = "the longest" },
  { "gap_max_frame", type = "integer", where = "json text", title = "in frame",
    help = "the message behind the longest gap" },
  { "crc_bad", type = "integer", kind = "crc", where = "json text window", title = "bad CRC",
    short = "CRC",
    help = "messages with a bad CRC" },
  { "incomplete", type = "integer", kind = "incomplete", where = "json text window",
    short = "lost",
    help = "messages without their beginning, with bytes missing, truncated or unfinished" },
  { "late", type = "integer", kind = "late", where = "json text window",
    help = "silences between two messages" },
  { "silent", where = "text window", title = "silent/s at the end",
    short = "silent/s" }, -- JSON has it as an event
  { "reboots", type = "integer", kind = "reboot", where = "json text",
    help = "how often the controller's clock went back" },
  { "values", type = "values", where = "json",
    help = "of each field of numbers `min`, `mean` and `max`" },
  { "invalid", type = "integer", kind = "invalid", where = "json text",
    help = "messages with a value that the catalogue does not define" },
  { "skipped", type = "integer", kind = "skipped", where = "json text",
    help = "stretches of bytes in a stream that belong to no frame" },
  { "missing", type = "integer", kind = "missing", where = "json text",
    help = "messages missing by Seq No" },
  { "copies", type = "integer", kind = "copies", where = "json text",
    help = "messages that were recorded a second time" },
}
--- The columns, see output.columns.
M.COLUMNS = COLUMNS

local RANGE = output.words("min mean max")
local VALUES = output.columns {
  { "who", where = "window" },
  { "bus", where = "text" },
  { "id", where = "text" },
  { "source", where = "text" },
  { "message", where = "text" },
  { "field", where = "text window" },
  { "unit", where = "text window" },
  { "min", where = "text window" },
  { "mean", where = "text window" },
  { "max", where = "text window" },
  { "count", where = "text" },
}

local Summary = groups.class { follows_changes = true }

--- See groups.class.
M.new = Summary.new

local function row_of(group, ending)
  local row = output.row(group.source, { count = group.count })
  if not ending.lacks_times then
    local rate, gap_mean = groups.pace(group)
    row.rate, row.gap_mean = rate, output.seconds(gap_mean)
    row.gap_min, row.gap_max = output.seconds(group.gap_min), output.seconds(group.gap_max)
    row.gap_max_frame = group.gap_max_frame
  end
  row.silent = group.silent
  for _, column in ipairs(COLUMNS.all) do
    if column.kind then row[column.key] = group.counts[column.kind].seen end
  end
  return row
end

--- End, see stat.derive.
function Summary:finish(ending, notes)
  local rows, shown, context = {}, {}, self.context
  for i, group in ipairs(self:sorted()) do
    local names, ranges = {}, {}
    for j, values in ipairs(group.values) do
      local row = groups.row(group, values)
      names[j], ranges[row.field] = row.field, output.object(RANGE, row)
      if row.min then shown[#shown + 1] = row end
    end
    rows[i] = row_of(group, ending)
    rows[i].values = output.object(names, ranges)
  end
  local sources = output.count(#rows, "source")
  local title = ("YAPP summary: %s in %.3f s"):format(sources, ending.now or 0)
  output.print(context, title, COLUMNS, rows, notes)
  if shown[1] and not context.json then
    context.out("\n")
    output.table(context, VALUES, shown)
  end
end

-- compare -----------------------------------------------------------------------------------------

local OF_SOURCE = output.words("bus id source count min mean max")
-- People read a line for each field and source.
local COMPARED = output.columns {
  { "message", where = "json" },
  { "field", where = "json text window", help = "the field" },
  { "unit", type = "string", where = "json text window", help = "its unit" },
  { "who", where = "text window" },
  { "min", where = "text window" },
  { "mean", where = "text" }, -- the window of Summary has it
  { "max", where = "text window" },
  { "far", where = "text window", title = "far from the others", short = "far" },
  { "spread", type = "number", where = "json text window",
    help = "the largest difference of the sources at one time" },
  { "time", where = "json", help = "when they differ by it" },
  { "rel", where = "text" },
  { "frame", where = "json text" },
  { "sources", type = "list", where = "json", help = "`" .. table.concat(OF_SOURCE, " ") .. "`" },
}
--- The columns of compare, see output.columns.
M.COMPARED = COMPARED

local Compare = groups.class { compares = true, wants_messages_only = true }

--- See groups.class.
M.compare = Compare.new

-- A value is far from those of the others if it is so many times as far from their median as they
-- usually are: 1.5 times the median of their distances, or a share of the median, or an amount.
-- The page of a flight has the same numbers.
local FAR, USUAL = 4, 0.02
local LEAST = { ["°C"] = 1, V = 0.05, A = 0.1, W = 1, RPM = 1 }

-- numbers  sorted by it
local function median(sorted)
  table.sort(sorted)
  local half = #sorted / 2
  return (sorted[math.floor(half + 0.5)] + sorted[math.floor(half + 1)]) / 2
end

-- Return "▲" or "▼" if one of several numbers is far above or below the others, else nil.
local function far_mark(numbers, index, unit)
  local others, distances = {}, {}
  for i, number in ipairs(numbers) do
    if i ~= index then others[#others + 1] = number end
  end
  if #others < 2 then return nil end
  local middle = median(others)
  for i, other in ipairs(others) do distances[i] = math.abs(other - middle) end
  local least = LEAST[unit or ""] or 0.001
  local usual = math.max(1.5 * median(distances), USUAL * math.abs(middle), least)
  local away = numbers[index] - middle
  return math.abs(away) >= FAR * usual and (away > 0 and "▲" or "▼") or nil
end

-- Say of the rows of a field which values are far from the others: "▲ mean ▲ max"; in a
-- window, which has no mean, the arrows alone.
local function mark_far(rows)
  for _, key in ipairs(RANGE) do
    local numbers, of = {}, {}
    for _, row in ipairs(rows) do
      if row[key] then numbers[#numbers + 1], of[#of + 1] = row[key], row end
    end
    for i, row in ipairs(of) do
      local mark = far_mark(numbers, i, rows[1].unit)
      if mark then
        local far = row.far or { text = "", short = "" }
        far.text = far.text .. (far.text ~= "" and " " or "") .. mark .. " " .. key
        if far.short:sub(-#mark) ~= mark then far.short = far.short .. mark end
        row.far = far
      end
    end
  end
end

-- Append the rows of a field: one for each source, the first with the spread of all and with what
-- JSON has, which is all that is needed there.
local function add_rows(self, list, index, rows)
  local spread, sources, first, all = list[1].values[index].spread, {}, #rows + 1, {}
  for i, group in ipairs(list) do
    local row = groups.row(group, group.values[index])
    sources[i], all[i] = output.object(OF_SOURCE, row), row
    if i == 1 or not self.context.json then rows[#rows + 1] = row end
  end
  mark_far(all)
  for i = 2, #all do all[i].field, all[i].unit = nil, nil end
  local row, rel = rows[first], spread.rel
  row.spread, row.frame, row.rel = spread.worst, spread.frame, output.seconds(rel)
  row.time = rel and output.time(self.context.queue:clock(rel))
  row.sources = output.list(sources)
end

-- Return the name of a group's source with numbers that sort as numbers: M2 before M10.
local function sortable_name(group)
  local name = output.row(group.source, {}).who
  return (name:gsub("%d+", function(digits) return ("%012d"):format(digits) end))
end

-- Return the groups of each message that has several: for people by name, first the message with
-- most fields, which says most of a controller.
local function compared(self)
  local by_message, lists = {}, {}
  for _, group in ipairs(self:sorted()) do
    local message = group.message
    if message then
      local list = by_message[message] or {}
      by_message[message], list[#list + 1] = list, group
      if #list == 2 then lists[#lists + 1] = list end
    end
  end
  if self.context.json then return lists end
  for _, list in ipairs(lists) do output.sort(list, sortable_name) end
  output.sort(lists, function(list) return -#list[1].message.fields end)
  return lists
end

--- End: print a table for each message.
function Compare:finish(_, notes)
  local context, lists = self.context, compared(self)
  for i, list in ipairs(lists) do
    local rows = {}
    for index in ipairs(list[1].values) do add_rows(self, list, index, rows) end
    local title = ("YAPP compare: %d sources of %s"):format(#list, list[1].message.title)
    if i > 1 and not context.json then context.out("\n") end
    output.print(context, title, COMPARED, rows, notes)
    notes = {}
  end
  if not lists[1] then
    output.print(context, "YAPP compare: no message has several sources", COMPARED, {}, notes)
  end
end

return M
]=])
module("yapp.stat.taps", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- Statistics in tshark (-z yapp,...): taps, output, exit codes.  Wireshark's windows are
-- stat.menu's.  Wireshark's API.

local command = require "yapp.host.command"
local joined = require "yapp.base.joined"
local menu = require "yapp.stat.menu"
local options_of = require "yapp.stat.options"
local output = require "yapp.stat.output"
local queue = require "yapp.stat.queue"

local M = {}

-- While this is asked for, trees have the exact time, and the fields of CAN headers.
local CLOCK = "frame.time_epoch || can.id || can.flags.xtd == 1 || can.flags.rtr == 1"
local IS_TSHARK = not gui_enabled() -- Wireshark may revisit all packets
local FAILED = "the plugin failed, so the answer is incomplete: %s, see the filter _ws.lua.error"
local UNREAD = "only %d of %d packets were read, as the reading was stopped, or another window " ..
  "read: press Refresh"
local GOES_ON = "only %s were read: the live capture (-b) went on in %s, which tshark " ..
  "does not analyse: read each file with tshark -r"
local RELOADED = "Lua plugins were reloaded while the capture was open, so not all of it is " ..
  "known: reload the capture, too (Ctrl+R)"
local BUSY = "YAPP: another window is still reading the packets: press Refresh when it is done\n"

local Stat = {}
Stat.__index = Stat

--- Make the statistics of one plugin.
-- parts  {
--   settings   read from the preferences, {
--     version       of the plugin; catalogue = compiled
--     late          a gap of more periods is a silence
--     sources       a message.sources; sources_text = the preference that it was read from
--     ids           [message name] = list of the IDs that its preference has
--     problems      list of texts: wishes of the user that were not met }
--   intake     a stat.intake, builder = a show.tree, buses = a host.buses
--   reading    a reading.reading, frames = a host.can, deferral = its host.deferral
--   find_options  function() -> list of tshark's options that may decode what was not found, and
--              those of them that certainly decode YAPP
--   notes      function() -> list of texts to say of streams
--   watch      function(), called when statistics begin
--   unwatch    function(), called in Wireshark when one has ended
--   counted    function(f) -> f, whose calls are counted
--   calls      { begun, ended = numbers }: of these calls since the capture was opened }
function M.new(parts)
  parts.show = nil -- in Wireshark: function(text), which opens the window of an argument of -z
  parts.total = 0 -- in Wireshark: number of packets in the capture, see count_packets
  return setmetatable(parts, Stat)
end

-- Output ----------------------------------------------------------------------------------------

-- Return the hint if tshark has a display filter.
local function hint_of(options)
  local is_there = options.Y or options["display-filter"]
  return is_there and "-Y does not narrow a statistic: use filter=EXPRESSION as its last option"
end

local function say(text)
  io.stderr:write("yapp: ", (text:gsub("\n", "\nyapp: ")), "\n")
end

-- Make a folder, and those above it; return whether it is there.
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

-- The tap that asks for the field which has the time to the nanosecond (pinfo.abs_ts has steps of
-- 0.24 microseconds).
local function tap_clock(self)
  local clock = listen(self, CLOCK)
  clock.packet = self.counted(function(pinfo)
    if self.is_exact then return end
    for _, info in ipairs { all_field_infos() } do
      if info.name == "frame.time_epoch" then
        self.queue:begins(info.value.secs, info.value.nsecs, self.buses:time(pinfo))
        self.is_exact = true
      end
    end
  end)
  return clock
end

-- Make the tap that reads CAN headers once tap_packets has removed its own.
local function tap_headers(self)
  local tap, deferral = listen(self), self.deferral
  tap.packet = self.counted(function(pinfo, tvb) deferral:on_header(pinfo, tvb) end)
  return tap
end

-- The exact time is known: remove the tap of the clock, which builds trees.  If a filter has trees
-- built anyway, it stays: they have CAN ids, too.
local function end_trees(self, tap, clock)
  self.builder:only_pass()
  if not self.has_filter then
    clock:remove()
    self.deferral:allow()
  end
  if self.queue:go_direct() then self.intake:remove_later(tap) end
end

-- The tap that sees every packet.  In tshark it removes the tap of the clock once the exact time is
-- known, but in a second pass.
local function tap_packets(self)
  local tap, clock, is_waiting = listen(self), tap_clock(self), IS_TSHARK
  local calls, buses, deferral = self.calls, self.buses, self.deferral

  -- Every packet comes here, so nothing else is called that need not be.
  function tap.packet(pinfo, tvb)
    calls.begun = calls.begun + 1
    if deferral.number then deferral:on_header(pinfo, tvb) end
    if is_waiting and self.is_exact then
      is_waiting = false
      if not self.frames:is_second_pass(pinfo.number) then end_trees(self, tap, clock) end
    end
    if deferral.is_undecided then deferral:decide(self.builder.wanted) end
    local rel = buses.found.start and buses:time(pinfo) or pinfo.rel_ts
    self.queue:packet(pinfo.number, rel, buses:lacks_clock())
    calls.ended = calls.ended + 1
  end

  -- All packets will be revisited.  In Wireshark another window that wants to read while this
  -- statistic reads resets all taps, too, although Wireshark then goes on with this reading.
  function tap.reset()
    if not IS_TSHARK and self.queue.packets > 0 then return end
    self.queue:reset()
    self.is_exact = false
    self.deferral:reset_counts()
  end
end

local function open(self)
  self.command, self.began = command.options(), os.time()
  self.queue, self.taps = queue.new(self.settings, hint_of(self.command)), {}
  self.is_exact, self.has_filter, self.headers = false, false, nil
  self.intake:open(self.queue)
  self.reading:listen(self.intake)
  self.deferral:open(function()
    if self.queue.is_direct then self.headers = self.headers or tap_headers(self) end
  end)
  self.watch()
  tap_packets(self)
end

local function close(self)
  for _, tap in ipairs(self.taps) do tap:remove() end -- a tap that stays would build trees for ever
  self.reading:listen(false)
  self.deferral:close()
  self.intake:close()
end

-- Return why packets of the capture were not read, nil if all were.
local function unread_of(self)
  local packets = self.queue.packets
  if not IS_TSHARK then
    return packets < self.total and UNREAD:format(packets, self.total) or nil
  end
  local files = command.count_later_files(self.command, self.began)
  if files == 0 then return nil end
  -- Where events are handed on at once, no tap counts the packets.
  local read = self.queue.is_direct and "those of the first file" or
    output.count(packets, "packet")
  return GOES_ON:format(read, files and output.count(files, "more file") or "more files")
end

-- End all statistics; return the exit code, and a list of texts to say.
local function finish(self)
  local failures, unread = self.calls.begun - self.calls.ended, unread_of(self)
  local failed = failures > 0 and FAILED:format(output.count(failures, "Lua error")) or nil
  local reading, buses, deferral = self.reading, self.buses, self.deferral
  local reloaded = self.total > 0 and buses:missed_file() and RELOADED or nil
  self.queue:end_packets()
  local options, certain = self.find_options()
  return self.queue:finish {
    unfinished = self.intake:finish(reading:finish(not IS_TSHARK)),
    drops = joined(buses:drops(), reading:drops()),
    lacks_times = buses:lacks_times(),
    options = options,
    certain = certain,
    notes = self.notes(),
    extended = deferral.extended,
    can = deferral.can,
    problems = joined({ failed }, { unread }, { reloaded }),
    unread = unread and "not all packets were read",
  }
end

-- Functions from here on raise errors.

local function tap_filter(self, filter)
  local ok, tap = pcall(listen, self, filter)
  if ok then return tap end
  local why = tostring(tap):match("is invalid %- (.*)$") or tap -- before that a line in this file
  error(("the filter %s is not one: %s"):format(filter, why), 0)
end

-- Begin the statistic of an argument of -z.
-- context  { out, frames } of output.print
local function begin(self, text, context)
  local options, events = options_of.read(text, self.settings.catalogue), self.queue
  -- In tshark, check names errors in its report, too.
  if options.problems[1] and (context.frames or options.what ~= "check") then
    error(table.concat(options.problems, "\n"), 0)
  end
  local filter = options.filter and tap_filter(self, options.filter)
  context.queue, context.settings = events, self.settings
  context.json, context.make_folder = options.json, make_folder
  local statistic = options.row.new(options, context)
  local deriver = events:add(statistic, options)
  if filter then
    self.has_filter = true
    filter.packet = self.counted(function(pinfo) deriver.matched[pinfo.number] = true end)
  end
end

--- Run a statistic over all packets, in Wireshark.
-- text     as behind -z
-- returns  its output and the problems, as one text; a list of the frames in it
function Stat:run(text)
  if self.is_reading then return BUSY, {} end
  self.is_reading = true
  local said, frames = {}, {}
  local function out(chunk) said[#said + 1] = chunk end
  open(self)
  local ok, texts = pcall(function()
    begin(self, text, { out = out, frames = frames })
    retap_packets()
    return select(2, finish(self))
  end)
  close(self)
  self.unwatch()
  self.is_reading = false
  local answer = table.concat(said)
  for _, problem in ipairs(ok and texts or { tostring(texts) }) do
    if not answer:find(problem, 1, true) then out(problem .. "\n") end
  end
  return table.concat(said), frames
end

-- tshark ----------------------------------------------------------------------------------------

-- All packets have come: print, name errors, and exit if the code is not 0.
local function conclude(self)
  local ok, code, texts = pcall(finish, self)
  if not ok then
    code, texts = output.EXIT_UNDECIDED, { tostring(code) }
  end
  local problem = self.problem or select(2, io.stdout:flush()) -- a full disk may show only here
  if problem then
    texts[#texts + 1] = "standard output: " .. problem
    if code == output.EXIT_OK then code = output.EXIT_UNDECIDED end
  end
  for _, text in ipairs(texts) do
    say(text)
  end
  -- Other -z statistics of this run lose the rest of their output: the exit code matters more.
  if code ~= output.EXIT_OK then os.exit(code) end
end

-- One -z argument.
local function read_argument(self, text)
  if not self.queue then
    open(self)
    local tap = Listener.new("frame") -- for the end alone: tap_packets may remove its own
    function tap.draw() conclude(self) end
  end
  begin(self, text, { out = function(chunk)
    local ok, problem = io.stdout:write(chunk)
    if not ok then self.problem = problem end
  end })
end

-- Count the packets of a capture in Wireshark, where the user may stop a statistic's reading.
-- note_packets  function(), to be called when some have come
local function count_packets(self, note_packets)
  local tap = Listener.new("frame")
  function tap.packet(pinfo)
    local number = pinfo.number
    if number > self.total then self.total = number end
  end
  tap.draw = note_packets
end

--- Forget the capture file.
function Stat:reset()
  self.total = 0
end

--- Register the menus of Wireshark.
function Stat:register_menus()
  local note_packets
  self.show, note_packets = menu.register(self)
  count_packets(self, note_packets)
end

--- Begin the statistic of an argument of -z.
function Stat:begin(text)
  if self.show then return self.show(text) end
  -- Wireshark swallows an error here, so all that can fail ends with a message and a code.
  local ok, problem = pcall(read_argument, self, text)
  if not ok then
    say(tostring(problem))
    os.exit(output.EXIT_UNDECIDED)
  end
end

return M
]=])
module("yapp.stat.undecoded", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- Messages that were not decoded, or only in part: how many, of which sources and sizes, and which
-- preference decodes them.  Pure Lua, 5.2 to 5.5.

local compiler = require "yapp.message.catalogue"
local input = require "yapp.base.input"
local memo = require "yapp.base.memo"
local output = require "yapp.stat.output"
local source_names = require "yapp.message.sources"

local M = {}

local MAX_NAMED = 30 -- sources, or sizes, in a text

local bus_and_id = output.bus_and_id

local Undecoded = {}
Undecoded.__index = Undecoded

local function new_list()
  return {}
end

--- Make an empty list.
-- settings  see stat.taps
function M.new(settings)
  return setmetatable({
    settings = settings,
    -- Messages that were not decoded at all: { source, size, likes = messages of this size,
    -- is_own = whether that of the source is one, is_decodable = whether a preference of IDs can
    -- decode it, about = a text, values = of its events } each.
    whole = {},
    parts = {}, -- the same of those whose first bytes were decoded
    sizes = {}, -- by ID: the size of decodable messages; false for several, or if it has a message
    by_source = memo(new_list), -- by source, by size
  }, Undecoded)
end

-- Return the text about a size.
-- own     the source's message, is_own = whether this message has the size
-- titles  of the messages that have it
local function describe(own, is_own, titles)
  if is_own then return ("%s with a YAPP CTL other than 0"):format(own.title) end
  if titles[1] then return "the size of " .. table.concat(titles, " and of ") end
  return own and ("%s has %d"):format(own.title, own.size) or "the size of no known message"
end

local function new_entry(self, source, size, rest)
  local own, titles, is_own = source.message, {}, false
  local is_grown = own and size > own.size -- it begins with the own message
  local likes = is_grown and {} or compiler.of_size(self.settings.catalogue.messages, size)
  for i, message in ipairs(likes) do
    titles[i] = message.title
    is_own = is_own or message == own
  end
  local about, like = describe(own, is_own, titles), likes[1]
  local note = rest and ("the last %d not decoded, "):format(rest) or "not decoded, "
  return {
    source = source,
    size = size,
    likes = likes,
    is_own = is_own,
    is_decodable = not (rest or is_own) and like and source.id <= input.MAX_ID,
    about = about,
    values = { size = size, count = 0, note = note .. about, like = like and like.name },
  }
end

local function add(self, entry, list)
  local id, sizes, size = entry.source.id, self.sizes, entry.size
  list[#list + 1] = entry
  if entry.is_decodable then
    local is_only = sizes[id] == nil or sizes[id] == size
    sizes[id] = is_only and not entry.source.message and size
  end
end

--- Note a message.
-- source   see stat.kinds
-- size     of its payload; rest: how many bytes of it were not decoded, nil for all
-- returns  the values of an `unknown` event: one table for each source and size, whose count grows
function Undecoded:note(source, size, rest)
  local by_size = self.by_source[source]
  local entry = by_size[size]
  if not entry then
    entry = new_entry(self, source, size, rest)
    by_size[size] = entry
    add(self, entry, rest and self.parts or self.whole)
  end
  entry.values.count = entry.values.count + 1
  return entry.values
end

-- Preferences -------------------------------------------------------------------------------------

-- "0x210-0x213,0x300"
local function ranges_of(ids)
  local texts, first = {}, nil
  table.sort(ids)
  for i, id in ipairs(ids) do
    first = first or id
    if ids[i + 1] ~= id and ids[i + 1] ~= id + 1 then
      texts[#texts + 1] = (first == id and "0x%x" or "0x%x-0x%x"):format(first, id)
      first = nil
    end
  end
  return table.concat(texts, ",")
end

-- "can1/0x210=health:left", a part of yapp.sources.
local function part_of(entry)
  local source = entry.source
  local address = source_names.address(source.bus, source.id)
  return ("%s=%s:%s"):format(address, entry.likes[1].name, source.name or "")
end

-- Return the preferences that decode the entries: by message the IDs for all buses, parts of
-- yapp.sources for other IDs, and a list of other options.
local function plan(self)
  local ids, parts, options, taken = {}, {}, {}, {}
  for _, row in ipairs(self.settings.sources:list()) do
    if row.id then taken[bus_and_id(row)] = true end -- the first part for a bus and ID holds
  end
  for _, entry in ipairs(self.whole) do
    local id, key = entry.source.id, bus_and_id(entry.source)
    if entry.is_own then
      options[1] = "-o yapp.all_extended:TRUE"
    elseif entry.is_decodable and self.sizes[id] then
      for _, message in ipairs(entry.likes) do
        ids[message] = ids[message] or {}
        table.insert(ids[message], id)
      end
    elseif entry.is_decodable and not taken[key] then
      taken[key], parts[#parts + 1] = true, part_of(entry)
    end
  end
  return ids, parts, options
end

-- Return a text in quotes that a shell takes as it is.  Windows has double quotes alone, but a name
-- with one of these signs would end them, or run a program.
local function in_quotes(text)
  if not text:find('["$`\\!]') then return '"' .. text .. '"' end
  return "'" .. text:gsub("'", "'\\''") .. "'"
end

-- Return the complete preferences that decode the rest: a text, "" for none.
local function advice_of(self)
  local settings, sizes = self.settings, {}
  local ids, parts, texts = plan(self)
  for _, message in ipairs(settings.catalogue.messages) do
    local list = ids[message]
    if list then
      for _, id in ipairs(settings.ids[message.name]) do list[#list + 1] = id end
      local option = ("-o yapp.%s_ids:%s"):format(message.name, ranges_of(list))
      texts[#texts + 1] = sizes[message.size] and "or " .. option or option
      sizes[message.size] = true
    end
  end
  if parts[1] then
    if settings.sources_text:find("%S") then table.insert(parts, 1, settings.sources_text) end
    texts[#texts + 1] = "-o " .. in_quotes("yapp.sources:" .. table.concat(parts, ","))
  end
  return texts[1] and ". Try " .. table.concat(texts, " ") or ""
end

-- Texts -------------------------------------------------------------------------------------------

-- Join the first of many texts.
local function join(texts, between)
  local more = #texts - MAX_NAMED
  if more > 0 then texts[MAX_NAMED + 1] = ("and %d more"):format(more) end
  return table.concat(texts, between, 1, math.min(#texts, MAX_NAMED + 1))
end

-- "can1 0x211, 0x212 (32 bytes each, the size of Motor Data)": entries of one size, which are
-- sorted; and how many messages they are.
local function group_text(entries)
  local texts, count, bus = {}, 0, nil
  output.sort(entries, function(entry) return entry.source.bus or "", entry.source.id end)
  for i, entry in ipairs(entries) do
    local source = entry.source
    texts[i] = source.bus == bus and ("0x%x"):format(source.id) or bus_and_id(source)
    bus = source.bus
    count = count + entry.values.count
  end
  local shape = count > 1 and "%s (%d bytes each, %s)" or "%s (%d bytes, %s)"
  return shape:format(join(texts, ", "), entries[1].size, entries[1].about), count
end

-- "648 messages were not decoded: ...", of entries; nil if there are none.
local function text_of(entries, what)
  local groups, texts, total = {}, {}, 0
  local by_shape = memo(new_list, groups)
  for _, entry in ipairs(entries) do
    table.insert(by_shape[entry.size .. entry.about], entry)
  end
  for i, group in ipairs(groups) do
    local text, count = group_text(group)
    texts[i], total = text, total + count
  end
  if total == 0 then return nil end
  local count, were = output.count(total, "message"), total == 1 and "was" or "were"
  return ("%s %s %s: %s"):format(count, were, what, join(texts, "; "))
end

--- Return the texts on undecoded messages and the preferences that decode them: a list, empty for
-- none.
function Undecoded:texts()
  local texts, whole = {}, text_of(self.whole, "not decoded")
  if whole then texts[1] = whole .. advice_of(self) end
  texts[#texts + 1] = text_of(self.parts, "decoded in part")
  return texts
end

return M
]=])
module("yapp.wire.can_id", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- YAPP's use of a CAN frame: the 29-bit id, CAN FD padding, the header that the CRC covers ("CAN
-- Framing"). Pure Lua, 5.2 and 5.4.

local crc = require "yapp.wire.crc"

local M = {}

local char, floor = string.char, math.floor

--- The slots of bus n begin at n * M.BUS, see M.slot.
M.BUS = 0x20000000

-- CAN CTRL: 0 is a single frame, 2 a Middle.
M.START, M.END = 1, 3
M.CTRL_NAMES = { [0] = "Single", "Start", "Middle", "End" }

-- The lengths of CAN FD frames above 8 bytes: SHORTER[12] = 8 is the next shorter one.
local SHORTER, shorter = {}, 8
for _, length in ipairs { 12, 16, 20, 24, 32, 48, 64 } do
  SHORTER[length], shorter = shorter, length
end

local function split(fields_of, id)
  local ctrl = floor(id / 0x4000) % 0x10
  local fields = {
    id = floor(id / 0x40000),
    ctrl = ctrl,
    ctl = floor(id / 0x100) % 0x40,
    seq = floor(id % 0x100),
    message_key = id - ctrl * 0x4000,
  }
  fields_of[id] = fields
  return fields
end

--- The fields of a 29-bit CAN id ("CAN Message IDs"): fields[id], for 0 .. 0x1FFFFFFF, is
--   { id = Msg ID, ctrl = CAN CTRL, ctl = YAPP CTL, seq = Seq No, message_key = what the frames of
--   a message share: the id without CAN CTRL }
-- The same id usually gets the same table, which only M.seed writes to.  The cache is weak: a bus
-- has few ids, but a hostile capture may have any number.
M.fields = setmetatable({}, { __mode = "v", __index = split })

--- Return the slot of a message: one number for its key and its bus.
-- bus  number; false where it is not known
function M.slot(fields, bus)
  return fields.message_key + (bus or 0) * M.BUS
end

--- Return how many bytes of CAN FD padding the last or only frame of a message has.
-- data    its captured bytes; reported: its length on the bus; needed: what the message still lacks
-- returns 0 if it fits exactly, the number of zero bytes if it is padded as CAN FD is, else nil
function M.padding(data, reported, needed)
  if reported == needed then return 0 end
  local least = SHORTER[reported]
  if least and needed > least and needed < reported and not data:find("[^%z]", needed + 1) then
    return reported - needed
  end
end

--- Return the payload size of a single frame whose message has `least` to `most` bytes: the largest
-- size that fits.  If 9 to 17 bytes are allowed, a frame of 12 bytes has a payload of 12, though it
-- may be 9 and padding; a frame of 20 bytes has 17 and padding.
-- data, reported  as for M.padding
-- returns         number; nil when it does not fit
function M.single_size(data, reported, least, most)
  if reported >= least and reported <= most then return reported end
  return M.padding(data, reported, most) and most
end

local function two_bytes(number)
  return char(number % 0x100, floor(number / 0x100))
end

--- The 12 bytes that the CRC covers before the payload ("Computing the UART and Ethernet Frame IDs
-- from the CAN ID").
-- fields    { id, seq, ctl }
-- size      of the payload; reserved: number, 0 when left out
function M.header(fields, size, reserved)
  return "YP" .. char(fields.seq, fields.ctl) .. two_bytes(fields.id) .. "\0\0" ..
    two_bytes(size) .. two_bytes(reserved or 0)
end

--- Return the CRC register behind that header.  The fields cache it, as seed and seed_size, for the
-- next message of the same id and size.
function M.seed(fields, size, reserved)
  if fields.seed_size == size and not reserved then return fields.seed end
  local seed = crc.of(M.header(fields, size, reserved))
  if not reserved then fields.seed, fields.seed_size = seed, size end
  return seed
end

--- Return the CRC of a message.
-- fields, reserved  as for M.header
function M.crc(fields, payload, reserved)
  return crc.update(M.seed(fields, #payload, reserved), payload, 1, #payload)
end

--- What a Start says ("Multi-Frame Start").
-- data     its captured bytes
-- returns  crc, size, reserved; each nil where its bytes are not there
function M.start(data)
  local a, b, c, d, e, f, g, h = data:byte(1, 8)
  return d and a + b * 0x100 + c * 0x10000 + d * 0x1000000, f and e + f * 0x100, h and g + h * 0x100
end

return M
]=])
module("yapp.wire.crc", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- CRC-32K/6.4 (Koopman), the check value of YAPP frames.  Pure Lua.
--
-- Polynomial 0x1'32C0'0699, most significant bit first, not reflected, initial value 0xFFFFFFFF, no
-- final xor (vendor document, "CRC Calculation").

local bits = require "yapp.base.bits"

local M = {}

local POLYNOMIAL = 0x32C00699
M.INITIAL = 0xFFFFFFFF

local byte = string.byte

local TABLE = {}
for i = 0, 255 do
  local register = i * 0x1000000
  for _ = 1, 8 do
    local top = register >= 0x80000000
    register = register * 2 % 0x100000000
    if top then register = bits.bxor(register, POLYNOMIAL) end
  end
  TABLE[i] = register
end

-- For Lua 5.3 and later, whose operators are syntax errors before.
local native = load([[
  local TABLE, byte = ...
  return function(register, data, from, to)
    local index = from or 1
    to = to or #data
    while index + 3 <= to do
      local a, b, c, d = byte(data, index, index + 3)
      register = (register << 8 & 0xFFFFFFFF) ~ TABLE[register >> 24 ~ a]
      register = (register << 8 & 0xFFFFFFFF) ~ TABLE[register >> 24 ~ b]
      register = (register << 8 & 0xFFFFFFFF) ~ TABLE[register >> 24 ~ c]
      register = (register << 8 & 0xFFFFFFFF) ~ TABLE[register >> 24 ~ d]
      index = index + 4
    end
    for i = index, to do
      register = (register << 8 & 0xFFFFFFFF) ~ TABLE[register >> 24 ~ byte(data, i)]
    end
    return register
  end
]], "=wire.crc native")

-- For Lua 5.2, where a call costs more than a table look-up.  A step takes eight bytes, each
-- through a table of its own.  Arithmetic splits the register into its four bytes, which go through
-- tables, too.
local function with_library()
  local bxor, lshift, rshift = bits.bxor, bits.lshift, bits.rshift
  local NEXT = { [0] = TABLE }
  for k = 1, 7 do
    NEXT[k] = {}
    for i = 0, 255 do
      local register = NEXT[k - 1][i]
      NEXT[k][i] = bxor(lshift(register, 8), TABLE[rshift(register, 24)])
    end
  end
  local T0, T1, T2, T3 = NEXT[0], NEXT[1], NEXT[2], NEXT[3]
  local T4, T5, T6, T7 = NEXT[4], NEXT[5], NEXT[6], NEXT[7]
  return function(register, data, from, to)
    local index = from or 1
    to = to or #data
    while index + 7 <= to do
      local a, b, c, d, e, f, g, h = byte(data, index, index + 7)
      local z = register % 0x100
      register = (register - z) / 0x100
      local y = register % 0x100
      register = (register - y) / 0x100
      local x = register % 0x100
      local w = (register - x) / 0x100
      register = bxor(T7[w], T6[x], T5[y], T4[z],
        T7[a], T6[b], T5[c], T4[d], T3[e], T2[f], T1[g], T0[h])
      index = index + 8
    end
    for i = index, to do
      local low = register % 0x1000000
      register = bxor(low * 0x100, T0[(register - low) / 0x1000000], T0[byte(data, i)])
    end
    return register
  end
end

--- Return the CRC register behind data[from .. to].
-- register  before these bytes, 0 .. 0xFFFFFFFF; M.INITIAL to begin with
-- data      string
-- from, to  1-based, inclusive; the whole string when left out
-- returns   the new register, 0 .. 0xFFFFFFFF.  Document: "CRC Calculation".
M.update = native and native(TABLE, byte) or with_library()

--- The CRC of a string, from the initial value.
function M.of(data)
  return M.update(M.INITIAL, data)
end

return M
]=])
module("yapp.wire.frame", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- The frame of a serial stream and of Ethernet: its header and the CRC behind the payload.  Pure
-- Lua.
--
--   "YP", seq (1), ctl (1), id (4), size (2), reserved (2), payload (size), CRC (4), little endian
--   (vendor document, "UART Stream Framing").

local M = {}

local byte = string.byte

--- The first bytes of a frame; the sizes of header, CRC and the largest frame.
M.SYNC = "YP"
M.HEADER, M.CRC_SIZE = 12, 4
M.LARGEST = M.HEADER + 65535 + M.CRC_SIZE

--- The highest id that a message of the document has.
M.MAX_ID = 2047

--- The fields of a header.
-- bytes    string
-- from     1-based index of its "YP", which is not checked
-- returns  id, size, reserved, seq, ctl: as they stand there, plausible or not; nil where fewer
--          than 12 bytes are left
function M.parse(bytes, from)
  local seq, ctl, id0, id1, id2, id3, size0, size1, rest0, rest1 = byte(bytes, from + 2, from + 11)
  if not rest1 then return nil end
  local id = id0 + id1 * 0x100 + id2 * 0x10000 + id3 * 0x1000000
  return id, size0 + size1 * 0x100, rest0 + rest1 * 0x100, seq, ctl
end

--- The CRC of a frame, as sent.
-- bytes    string; to: 1-based, the last byte of the frame
function M.crc(bytes, to)
  local a, b, c, d = byte(bytes, to - 3, to)
  return a + b * 0x100 + c * 0x10000 + d * 0x1000000
end

--- Return whether the header at a "YP" is as the document has it; false where it is not complete.
-- bytes, from  as for M.parse
function M.is_plausible(bytes, from)
  local id, _, reserved = M.parse(bytes, from)
  return id ~= nil and id <= M.MAX_ID and reserved == 0
end

--- Return the index of the next "YP" from a 1-based index on; nil without one.
function M.find(bytes, from)
  return bytes:find("YP", from, true)
end

return M
]=])
return chunk(folder .. "yapp.lua", [=[
-- SPDX-License-Identifier: GPL-2.0-or-later
-- YAPP for Wireshark: the packet protocol of Taurus motor controllers on CAN, UART, TCP and UDP.
-- The entry point: makes the protocols, preferences and dissectors and registers them.  README.md
-- says how to use the plugin.

local VERSION = "2.3.0"
local EXIT_UNDECIDED = 21 -- as in stat.output, which may be what does not load
local here = debug.getinfo(1, "S").source:match("^@(.*[/\\])") or "./"

-- If there are two copies, in the plugin folder and by -X, or by -X twice, only the first one
-- loads.
local loaded = package.loaded["yapp.plugin"]
if loaded then
  local text = "yapp: %syapp.lua (%s) is not loaded: %s (%s) is already there"
  if loaded.version ~= VERSION then text = text .. "; remove or update one of the two" end
  io.stderr:write(text:format(here, VERSION, loaded.path, loaded.version), "\n")
  return loaded
end
-- An installed plugin has all modules in this file (package.preload); a clone has them in a folder.
if not package.preload["yapp.wire.crc"] and here:find(Dir.personal_plugins_path(), 1, true) then
  local text = "yapp: %s is a clone in a plugin folder, where Wireshark runs every file: " ..
    "move it elsewhere, and run make install or tools/install.py there\n"
  io.stderr:write(text:format(here))
end
set_plugin_info { version = VERSION, author = "the YAPP for Wireshark project",
  description = "YAPP, the packet protocol of Taurus motor controllers, on CAN, UART, TCP and UDP" }

-- Set the decimal point, as in Wireshark's own times and filters, whatever the user's locale has.
-- With a decimal comma "%.1f" writes text that no program reads, Lua 5.2 cannot read "2.5", and Lua
-- source made from numbers does not compile.
os.setlocale("C", "numeric")

-- Find modules beside this file: in package.path a folder cannot have ";" or "?" in its name.
table.insert(rawget(package, "searchers"), 2, function(name)
  if not name:find("^yapp%.") then return nil end
  local path = here .. name:gsub("%.", "/") .. ".lua"
  local ok, chunk, why = pcall(loadfile, path) -- Wireshark's raises what is wrong, without the path
  return ok and chunk or error(why or path .. ": " .. chunk, 0)
end)

local binary = require "yapp.message.binary"
local bus_finder = require "yapp.host.buses"
local can_id = require "yapp.wire.can_id"
local catalogue_files = require "yapp.message.catalogue_files"
local compiler = require "yapp.message.catalogue"
local field_kinds = require "yapp.message.field_kinds"
local file_readers = require "yapp.file.readers"
local frame = require "yapp.wire.frame"
local joined = require "yapp.base.joined"
local later = require "yapp.base.later"
local message_types = require "yapp.message.types"
local ports = require "yapp.host.ports"
local preferences = require "yapp.host.preferences"
local show_fields = require "yapp.show.fields"
local socketcan = require "yapp.host.socketcan"
local source_names = require "yapp.message.sources"
local stat_names = require "yapp.stat.names"

-- Captures without YAPP need none of these.
local can_dissector = later "yapp.host.can"
local packet_menu = later "yapp.show.packet_menu"
local reading_of = later "yapp.reading.reading"
local serial_dissector = later "yapp.host.serial"
local show_frame = later "yapp.show.frame"
local show_packet = later "yapp.show.packet"
local show_tree = later "yapp.show.tree"
local stat_intake = later "yapp.stat.intake"
local stat_taps = later "yapp.stat.taps"
local usb = later "yapp.host.usb"

-- The user's own messages follow the plugin's.  They come from yapp_messages.lua in Wireshark's
-- personal configuration folder, and from the files that a preference and the environment name.
-- Fields can be registered only while a plugin loads, and then the API tells no preference.  So the
-- default profile's preference is read from its file.
local default_profile = Dir.personal_config_path("preferences")
local chosen_file = catalogue_files.preference(default_profile, "yapp.messages")

local function load_catalogue()
  local files = { { path = here .. "taurus_fields.lua" },
    { path = Dir.personal_config_path("yapp_messages.lua"), optional = true } }
  for _, path in ipairs { chosen_file or "", os.getenv("YAPP_MESSAGES") or "" } do
    if path ~= "" then files[#files + 1] = { path = path } end
  end
  local compiled, problems = catalogue_files.load(files, show_fields.EXPERT_NAMES)
  preferences.complain(problems)
  return compiled, #problems == 0
end

-- Protocols and preferences -----------------------------------------------------------------------

local catalogue, is_whole = load_catalogue()
local yapp = Proto("yapp", "Yet Another Packet Protocol")
local all = Proto("yapp_all", "YAPP (all extended frames)")
local serial = Proto("yapp_serial", "YAPP serial stream")
local skipped = Proto("yapp_skipped", "YAPP, bytes between the frames of a serial dump")
local taurus = Proto("taurus", "Taurus motor controller")
local header = Proto("yapp_socketcan", "YAPP reads CAN headers")
local tcp_header = Proto("yapp_tcp", "YAPP reads TCP headers")
local usb_header = Proto("yapp_usb", "YAPP reads USB headers")
local server = Proto("yapp_port", "YAPP looks for YAPP on a server's port")
preferences.define(yapp, catalogue, field_kinds, frame.MAX_ID)

local buses = bus_finder.watch()
local types = message_types.new(catalogue)
local default_names = {} -- titles by ID
for id, message in pairs(catalogue.by_id) do default_names[id] = message.title end
local yapp_fields = show_fields.of_yapp(yapp, default_names, catalogue.messages)
local taurus_fields = show_fields.of_taurus(taurus, catalogue.messages)

-- SocketCAN's table of ids calls YAPP for the ids registered in it alone, so other frames cost
-- nothing.
local START = can_id.START
local by_can_id = DissectorTable.get("can.extended_id")
local is_registered = {} -- [ID] = true; of an unknown ID { [Seq No] = true }

-- Register the CAN ids of an ID that carries a message: CAN CTRL 0 to 3 and every Seq No, with YAPP
-- CTL 0.
local function register_id(id)
  if is_registered[id] == true then return end
  is_registered[id] = true
  for ctrl = 0, 3 do
    local first = id * 0x40000 + ctrl * 0x4000
    by_can_id:add(("%d-%d"):format(first, first + 0xFF), yapp)
  end
end

-- Register those of an unknown ID: all Starts once one came, the other frames as Seq Nos come.  To
-- register all 1,024 of each of 2,000 IDs takes three times as long as 40,000 frames.
local function register_start(id, seq)
  local known = is_registered[id]
  if known == true or known and known[seq] then return end
  local first = id * 0x40000
  if not known then
    known = {}
    is_registered[id] = known
    by_can_id:add(("%d-%d"):format(first + START * 0x4000, first + START * 0x4000 + 0xFF), yapp)
  end
  known[seq] = true
  for ctrl = 0, 3 do
    if ctrl ~= START then by_can_id:add(first + ctrl * 0x4000 + seq, yapp) end
  end
end

-- What others need of the preferences, see stat.taps; read_preferences fills it.
local settings = { version = VERSION, catalogue = catalogue, accepts_all = false }

-- What reads and shows YAPP; nil until something needs it, see make_reading.
local reading, builder, frames, streams
local stat -- the same of statistics, see make_statistics

local function reset_reading()
  reading:reset { late = settings.late, catalogue = catalogue, buses = buses }
  builder:reset()
  frames:reset()
  streams:reset()
end

-- Make what reads and shows YAPP: a frame, a packet or a statistic needs it.
local function make_reading()
  if streams then return end
  reading = reading_of.new(types, buses)
  builder = show_tree.new {
    yapp = yapp,
    taurus = taurus,
    catalogue = catalogue,
    reading = reading,
    fields = yapp_fields,
    taurus_fields = taurus_fields,
    names = default_names,
  }
  frames = can_dissector.new(reading, show_frame.new(builder), builder, buses, register_start,
    settings)
  streams = serial_dissector.new(reading, show_packet.new(builder), builder, buses, tcp_header)
  reset_reading()
end

-- Return the options of tshark that may decode what was not found, and those of them that certainly
-- decode YAPP: two lists.
local function find_options()
  local found, options = buses.found, streams:options()
  local serial_options = streams:has_serial() and {} or found:serial_options()
  local certain = joined(found.has_serial_frames and serial_options or {}, options)
  return joined(serial_options, options), certain
end

-- Return the notes of statistics on streams: a packet list looks for YAPP only if the first bytes
-- may have it.
local function notes()
  return joined(buses.found.may_have_frames and {} or streams:notes(), usb.notes())
end

-- Dissectors --------------------------------------------------------------------------------------

-- A call that began and did not end failed: with a Lua error, which Wireshark shows in the packet
-- alone.
local calls = { begun = 0, ended = 0 }

local function counted(call)
  return function(...)
    calls.begun = calls.begun + 1
    if not streams then make_reading() end
    local result = call(...)
    calls.ended = calls.ended + 1
    return result
  end
end

-- Return the CAN id of a frame that did not come through the table of ids, as socketcan.find_id
-- does.
local function find_id(pinfo)
  local id, is_unknown = socketcan.find_id(pinfo)
  socketcan.wrap(header) -- from the next frame on the id is known
  return id, is_unknown
end

-- Decode As on CAN: every extended data frame is YAPP's.
local function dissect_any(tvb, pinfo, root)
  local id, is_unknown = find_id(pinfo)
  if id then return frames:dissect(tvb, pinfo, root, id, true) end
  return is_unknown and tvb:reported_len() > 0 and frames:without_id(tvb, pinfo, root) or 0
end

all.dissector = counted(dissect_any)

-- The heuristic sees every frame that no other dissector accepts.  With the preference
-- yapp.all_extended it accepts them; for a statistic it notes them.  It costs time for each such
-- CAN frame of every capture, so it is registered only when one of the two needs it.
local is_heuristic = false

local function unclaimed(tvb, pinfo, root)
  if settings.accepts_all then return dissect_any(tvb, pinfo, root) > 0 end
  frames.deferral:note(tvb, pinfo)
  return false
end

local function watch_unclaimed()
  socketcan.wrap(header)
  if is_heuristic then return end
  is_heuristic = true
  all:register_heuristic("can", counted(unclaimed))
end

-- The first frame makes the reading, and gives the table of ids the dissector of the others.
yapp.dissector = counted(function(tvb, pinfo, root)
  local dissect = frames:of_table(calls)
  yapp.dissector = dissect
  return dissect(tvb, pinfo, root)
end)

serial.dissector = counted(function(tvb, pinfo, root)
  return streams:dissect(tvb, pinfo, root)
end)

skipped.dissector = counted(function(tvb, pinfo, root)
  return streams:skipped(tvb, pinfo, root)
end)

-- Nothing calls this dissector, as YAPP shows the Taurus messages.  It must exist, because the API
-- asks by dissector whether a protocol is wanted (see show.tree).
function taurus.dissector() return 0 end

-- A conversation becomes YAPP's with its first packet that is YAPP.
local found_by_content = counted(function(tvb, pinfo, root)
  if not streams:accepts(tvb, pinfo, root) then return false end
  pinfo.conversation = serial
  streams:dissect(tvb, pinfo, root)
  return true
end)

-- Called for a port of host.ports.
local to_serial = Dissector.get("yapp_serial")
server.dissector = counted(function(tvb, pinfo, root)
  if not ports.is_of_others(pinfo) then return 0 end
  if not streams:accepts(tvb, pinfo, root) then return 0 end
  pinfo.conversation = serial
  return to_serial:call(tvb, pinfo, root)
end)
ports.use(server)

-- Each call of a heuristic costs time, and most captures are full of other TCP and UDP.  So search
-- only if the first bytes of a file may have a YAPP frame, if there are no packets yet (a live
-- capture), or for a statistic of tshark.
local is_searching = false

local function search_streams()
  if is_searching then return end
  is_searching = true
  serial:register_heuristic("tcp", found_by_content)
  serial:register_heuristic("udp", found_by_content)
  usb.watch(usb_header, counted(function(...) streams:dissect_usb(...) end))
end

-- Return the controller's own time of a frame in a raw dump ("Nanoseconds since boot"), nil for
-- none.
local function controller_time(bytes)
  local id, size = frame.parse(bytes, 1)
  local message = types:message_of(id)
  local time = message and message.time
  if not time or size < math.max(message.min_size, time.offset + 8) then return nil end
  if #bytes < frame.HEADER + size then return nil end
  local seconds, nanoseconds = binary.time(bytes, frame.HEADER + time.offset)
  if seconds >= 0 and nanoseconds >= 0 then return seconds, nanoseconds end
end

local function make_statistics()
  if stat then return end
  make_reading()
  stat = stat_taps.new {
    settings = settings,
    intake = stat_intake.new(catalogue),
    builder = builder,
    buses = buses,
    reading = reading,
    find_options = find_options,
    notes = notes,
    frames = frames,
    deferral = frames.deferral,
    counted = counted,
    calls = calls,
    watch = function()
      watch_unclaimed()
      if not gui_enabled() then search_streams() end
    end,
    -- A wrapper that is there when Wireshark reloads its Lua plugins takes SocketCAN away with it.
    unwatch = function()
      if not settings.accepts_all then socketcan.unwrap() end
    end,
  }
end

-- Begin the statistic of an argument of -z.  No module may be missing then, needed or not.
local function begin_statistic(text)
  if not (gui_enabled() or later.load_all()) then os.exit(EXIT_UNDECIDED) end
  make_statistics()
  stat:begin(text)
end

-- Preferences and files ---------------------------------------------------------------------------

-- List all that makes the answer of a statistic incomplete: a catalogue or preferences with
-- mistakes, and a file with messages that was not read, which is said once.
-- wrong  list of errors in preferences
local function list_problems(wrong)
  local problems, file = {}, yapp.prefs.messages
  if not is_whole then problems[1] = "the catalogue did not load whole" end
  if file ~= "" and file ~= chosen_file and file ~= os.getenv("YAPP_MESSAGES") then
    problems[#problems + 1] = file .. ", the file with your own messages, was not read"
    preferences.complain_once { file .. " is read at the next start, if the default profile " ..
      "names it; for one run set the environment variable YAPP_MESSAGES to it" }
  end
  for _, text in ipairs(wrong) do problems[#problems + 1] = "preferences: " .. text end
  return problems
end

local function read_preferences()
  local prefs, chosen = yapp.prefs, {}
  field_kinds.use_below_top(prefs.divisor)
  for _, message in ipairs(catalogue.messages) do
    chosen[message.name] = preferences.range(prefs[message.name .. "_ids"])
  end
  local by_id, clashes = compiler.assign(catalogue, chosen)
  local sources, unread = source_names.parse(prefs.sources, catalogue)
  local late, no_number = preferences.late(prefs.late)
  local link_types = preferences.take_link_types(prefs.user_dlt, serial)
  local wrong = joined(clashes, unread, no_number, link_types)
  preferences.complain_once(wrong)
  local hidden = { source = prefs.hide_source, values = prefs.hide_values }
  types:use(by_id, sources, hidden, register_id)
  settings.accepts_all = prefs.all_extended
  if settings.accepts_all then watch_unclaimed() end
  settings.late, settings.ids = late, chosen
  settings.sources, settings.sources_text = sources, prefs.sources
  settings.problems = list_problems(wrong)
end
yapp.prefs_changed = read_preferences

function yapp.init()
  calls.begun, calls.ended = 1, 0
  read_preferences()
  buses:init()
  socketcan.init()
  -- A first pass without trees tells a remote frame from data by its header alone.  The page in a
  -- browser pays for that; Wireshark's windows and sharkd, whose captures may be long, do not.
  if yapp_reads_headers then socketcan.wrap(header, not settings.accepts_all) end
  types:reset(buses:are_several())
  if stat then stat:reset() end
  if streams then reset_reading() end
  local found = buses.found
  if found.head then
    make_reading()
    streams:scan(found.head)
  end
  if yapp.prefs.search_all or found.may_have_frames then search_streams() end
  calls.ended = 1
end

-- Registration ------------------------------------------------------------------------------------

-- Register the Starts with Seq No 0 of all IDs: so begin unknown messages that are not numbered.
for id = 0, frame.MAX_ID do by_can_id:add(id * 0x40000 + START * 0x4000, yapp) end
for _, name in ipairs(stat_names) do register_stat_cmd_arg("yapp," .. name, begin_statistic) end
register_stat_cmd_arg("yapp", begin_statistic) -- the longest name that fits is called
if gui_enabled() then
  make_statistics()
  stat:register_menus()
  packet_menu.register(yapp.prefs, catalogue)
end
for name, proto in pairs {
  ["can.subdissector"] = all,
  ["tcp.port"] = serial,
  ["tls.port"] = serial,
  ["udp.port"] = serial,
  ["rtacser.data"] = serial,
} do
  DissectorTable.get(name):add_for_decode_as(proto)
end
file_readers.register {
  new_framer = function()
    make_reading()
    return reading:new_framer(frame.LARGEST)
  end,
  time_of = controller_time,
}

-- Collect garbage earlier and faster than Lua does by default: a long capture takes less memory and
-- no more time.  The start is faster without.  (COMPAT 5.5: these options have other names there,
-- hence pcall.)
pcall(collectgarbage, "setpause", 150)
pcall(collectgarbage, "setstepmul", 1000)

package.loaded["yapp.plugin"] = { version = VERSION, path = here .. "yapp.lua" }
]=])(...)
