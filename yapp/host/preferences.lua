-- SPDX-License-Identifier: GPL-2.0-or-later
-- The preferences: their names and texts, and the meaning of their values.  Wireshark's API.

local input = require "yapp.base.input"
local joined = require "yapp.base.joined"
local mapped = require "yapp.base.mapped"

local M = {}

local unpack = rawget(table, "unpack")
local FIRST_DLT, LAST_DLT = 147, 162 -- DLT_USER0 .. DLT_USER15

local is_said = {} -- by text

--- Show problems to the user, each text once, although preferences are read with each file: in one
-- dialog in Wireshark, on stderr in tshark.
-- texts  list
function M.complain(texts)
  local new = mapped(texts, function(text)
    local is_new = not is_said[text]
    is_said[text] = true
    return is_new and text
  end)
  if new[1] and gui_enabled() and report_failure then
    report_failure("YAPP: " .. table.concat(new, "\n"))
    return
  end
  for _, text in ipairs(new) do io.stderr:write("yapp: " .. text .. "\n") end
end

--- Set preferences, in Wireshark.
-- values  { [name without "yapp."] = value }
function M.set(values)
  for name, value in pairs(values) do set_preference("yapp." .. name, value) end
  apply_preferences()
  redissect_packets()
end

--- Return whether M.complain has shown a text.
function M.has_said(text)
  return is_said[text]
end

-- The preferences besides the IDs of the messages: name, constructor, title, default, description
-- (%s: the messages' periods), and the constructor's last argument.
local ROWS = {
  { "sources", "string", "Names of sources", "",
    "What to call an ID, everywhere or on one bus, and which message it carries: " ..
    "0x210=motor:left_fore, can1/0x210=motor:right_fore, 0x212=left_tail. Several IDs have " ..
    "one name with a plus between them: can0/0x000+0x200+0x210=left. A range names each of " ..
    "its IDs: can0/0x210-0x213=motor:M1..M4. A bus alone names all of " ..
    "its IDs: can2=tail. An interface without a name is if0 or if1, its number in the file." },
  { "messages", "string", "File with your own messages", "",
    "A Lua file like taurus_fields.lua. Its messages come after those of yapp_messages.lua in " ..
    "the personal configuration folder, which needs no setting. It is read when Wireshark " ..
    "starts, from the default profile's setting: a change takes effect at the next start. " ..
    "For one run alone set the environment variable YAPP_MESSAGES." },
  { "hide_source", "bool", "Leave the source out of Info", false,
    "Switch it on if a column shows yapp.source, as in the profile YAPP: Info and the tree " ..
    "then say Motor Data instead of Motor Data left. A message with a fault or a warning " ..
    "keeps its source, for the expert information." },
  { "hide_values", "bool", "Leave values out of Info that have columns", false,
    "Switch it on if columns show speed, voltage and current, as in the profile YAPP: Info " ..
    "then has the other values of Motor Data." },
  { "late", "string", "Report a gap longer than ... periods", "2.5",
    "A longer gap between two messages of a source is a warning, yapp.late. At 2.5 a single " ..
    "lost message causes no warning. Periods: %s." },
  { "all_extended", "bool", "All extended CAN frames are YAPP", false,
    "Switch it on for a bus that carries nothing but YAPP: you see unknown IDs, other YAPP " ..
    "CTL values and malformed frames, too. By default the plugin takes only what is surely " ..
    "YAPP." },
  { "search_all", "bool", "Look for YAPP in all TCP, UDP and USB traffic", false,
    "The plugin finds YAPP in TCP, UDP and USB by itself in live captures, and in files whose " ..
    "first 64 KB have a header. Switch it on if YAPP comes later in your files. It costs " ..
    "about 1 µs for each packet that no other dissector takes." },
  { "divisor", "enum", "Compressed floats divide by", 5, -- see message.field_kinds
    "2^N - 6 is what the devices send. Choose 2^N - 5 only to reproduce the figures printed " ..
    "in the worked examples of the vendor's document (0.4975 A, 749.26 RPM).",
    {
      { 1, "2^N - 6 (mapping)", 5 },
      { 2, "2^N - 5 (worked examples)", 4 },
    } },
  { "user_dlt", "range", "Link types that carry a serial stream", "",
    "147 to 162, the numbers of DLT_USER0 to DLT_USER15. Set it for serial captures with such " ..
    "a link type, if Wireshark's DLT_USER table is not convenient: this preference overrides " ..
    "that table. Usually empty.",
    LAST_DLT },
}

--- Give a protocol its preferences.
-- proto     Proto
-- messages  the message types
-- returns   a list of rows as ROWS, those of the messages first
function M.define(proto, messages)
  local of_messages = mapped(messages, function(message)
    local title, id = message.title, ("0x%x"):format(message.id)
    local about = ("The IDs that carry %s; %s by default, which Wireshark shows as %d. Change " ..
      "it if a controller has other IDs, or if several controllers share a bus: %s-0x%x."):format(
      title, id, message.id, id, message.id + 3)
    local label = ("%s message IDs (%s = %d)"):format(title, id, message.id)
    return { message.name .. "_ids", "range", label, id, about, input.MAX_ID }
  end)
  local periods = mapped(messages, function(message)
    return message.every and ("%s %g s"):format(message.title, message.every)
  end)
  for _, row in ipairs(ROWS) do row[5] = row[5]:format(table.concat(periods, ", ")) end
  local rows = joined(of_messages, ROWS)
  for _, row in ipairs(rows) do proto.prefs[row[1]] = Pref[row[2]](unpack(row, 3, 6)) end
  return rows
end

--- Return the numbers of a range, in its order.
-- text  as Wireshark writes a range, "528,768-771": it refuses all else
function M.parse_range(text)
  local numbers = {}
  for from, to in text:gmatch("(%d+)%-?(%d*)") do
    local first = tonumber(from)
    for number = first, tonumber(to) or first do numbers[#numbers + 1] = number end
  end
  return numbers
end

--- Return how many periods a gap may last, a number above 0; and a list of errors.
-- text  of the preference; if it is not a number above 0, use 2.5
function M.parse_late(text)
  local late = input.decimal(input.trim(text))
  if late and late > 0 then return late, {} end
  local problem = 'yapp.late: no number above 0 in "%s"; it is 2.5 until you change it'
  return 2.5, { problem:format(text) }
end

local given = {} -- [encapsulation that is ours] = its dissector before, or false

--- Give user link types to the serial dissector.  Give back those that the preference no longer
-- names.
-- text     of the preference
-- proto    of the serial dissector
-- returns  a list of errors
function M.register_link_types(text, proto)
  local encapsulations, problems = DissectorTable.get("wtap_encap"), {}
  for encapsulation, before in pairs(given) do
    encapsulations:remove(encapsulation, proto)
    if before then encapsulations:add(encapsulation, before) end
  end
  given = {}
  for _, dlt in ipairs(M.parse_range(text)) do
    local encapsulation = wtap.USER0 + dlt - FIRST_DLT
    if dlt < FIRST_DLT then
      local problem = "yapp.user_dlt: link type %d is no DLT_USER; those are 147 to 162"
      problems[1] = problems[1] or problem:format(dlt) -- a range may have many
    else
      given[encapsulation] = encapsulations:get_dissector(encapsulation) or false
      encapsulations:add(encapsulation, proto)
    end
  end
  return problems
end

return M
