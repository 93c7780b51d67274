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
local function remove_fault(set, flag)
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
      local fault, set = remove_fault(self.set, flag)
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
-- returns  the steps, a list of { fault, is_raised = true if it rises or falls }, with set = list
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
