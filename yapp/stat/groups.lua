-- SPDX-License-Identifier: GPL-2.0-or-later
-- What a statistic keeps of each source.  Pure Lua, 5.2 and 5.4.
--
-- A record is what a statistic gets of a message, or of a part of one that is lost: {
--   frame        number of the frame that shows it: a message's last; for a lost part the one at which it is noticed
--   rel          its time: seconds since the first packet
--   source       { key = of bus or stream and ID, bus_key = of bus or stream, or nil; bus = its name or nil,
--                name = that the user gave it or nil, id =, message = compiled or nil }: one table for all its records
--   seq, payload, fits = whether the message of the catalogue takes the payload
--   good         whether it came whole: CRC good, or a single frame; is_bad = whether its CRC is bad
--   change       of message.history, or nil: its flags, missing, late, reboot and stale; the rest only with a tree
--   lost         nil, "incomplete", "orphan", "overrun" or "unfinished"; is_end = whether an orphan is an End;
--                fault = { void = whether it came out that nothing is lost after all }: sure at the end only }
--
-- A statistic gets those that the user's filter lets count: message(record); one with sees_all gets all, and whether
-- they count: message(record, counts).

local M = {}

local Groups = {}
Groups.__index = Groups

--- make  function(source) -> what is kept of it, a table
function M.new(make)
  return setmetatable({ make = make, by_key = {}, list = {}, buses = {}, bus_count = 0 }, Groups)
end

--- What is kept of a record's source, with this source; made where it is the source's first record.
function Groups:of(record)
  local source = record.source
  local group = self.by_key[source.key]
  if group then return group end
  local bus = source.bus_key or false
  if not self.buses[bus] then self.bus_count, self.buses[bus] = self.bus_count + 1, self.bus_count + 1 end
  group = self.make(source)
  group.source, group.message, group.order, group.bus_order = source, source.message, #self.list + 1, self.buses[bus]
  self.by_key[source.key], self.list[#self.list + 1] = group, group
  return group
end

--- The seconds between two times, which are those of a capture: to the nanosecond, so that 0.1 s is no more than 0.1.
function M.span(from, to)
  return math.floor((to - from) * 1e9 + 0.5) / 1e9
end

--- All of them: by bus as these showed, then by ID.
function Groups:sorted()
  table.sort(self.list, function(a, b)
    if a.bus_order ~= b.bus_order then return a.bus_order < b.bus_order end
    if a.source.id ~= b.source.id then return a.source.id < b.source.id end
    return a.order < b.order
  end)
  return self.list
end

return M
