-- What a statistic keeps of each source.  Pure Lua, 5.2 and 5.4.
--
-- A record is what a statistic gets of a message, or of a part of one that is lost: {
--   frame        number of the frame that shows it: a message's last; for a lost part the one at which it is noticed
--   seconds, nanoseconds   its time, integers; rel = seconds since the first packet
--   key          of its source: bus or stream, and ID; bus_key: of its bus or stream
--   bus, source  names or nil; id, seq
--   message      compiled, nil for an ID that is not in the catalogue; payload; fits = whether the message takes it
--   good         whether it came whole: CRC good, or a single frame; is_bad = whether its CRC is bad
--   change       of yapp_history, or nil; times and frames in it are those of the capture
--   lost         nil, "incomplete", "orphan", "overrun" or "unfinished" }
--
-- A statistic gets those that the user's filter lets count: message(record); one with sees_all gets all, and whether
-- they count: message(record, counts).

local M = {}

local Groups = {}
Groups.__index = Groups

--- make  function(record) -> what is kept of its source, a table
function M.new(make)
  return setmetatable({ make = make, by_key = {}, list = {}, buses = {}, bus_count = 0 }, Groups)
end

--- What is kept of a record's source; made where it is the source's first.  It has key, bus, id, source and message.
function Groups:of(record)
  local group = self.by_key[record.key]
  if group then return group end
  local bus = record.bus_key or false
  if not self.buses[bus] then self.bus_count, self.buses[bus] = self.bus_count + 1, self.bus_count + 1 end
  group = self.make(record)
  group.key, group.bus, group.id, group.source = record.key, record.bus, record.id, record.source
  group.message, group.order, group.bus_order = record.message, #self.list + 1, self.buses[bus]
  self.by_key[record.key], self.list[#self.list + 1] = group, group
  return group
end

--- All of them: by bus as these showed, then by ID.
function Groups:sorted()
  table.sort(self.list, function(a, b)
    if a.bus_order ~= b.bus_order then return a.bus_order < b.bus_order end
    if a.id ~= b.id then return a.id < b.id end
    return a.order < b.order
  end)
  return self.list
end

return M
