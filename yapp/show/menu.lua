-- SPDX-License-Identifier: GPL-2.0-or-later
-- The submenu YAPP in the menu of a packet, from Wireshark 4.4 on.  Wireshark's API.

local preferences = require "yapp.host.preferences"

local M = {}

-- Title, the field that the packet must have, and whose values are shown alone.
local FILTERS = {
  { "Only this controller", "yapp.source" },
  { "Whole message", "yapp.reassembled.in" },
}

-- Add an item.
-- name  of a field that the packet must have
-- act   function(values): by name those of YAPP's fields, and of frame.number, as a display filter
--       writes them, with commas between
local function add_item(title, name, act)
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

--- Make the items, from Wireshark 4.4 on.
-- prefs      of yapp
-- catalogue  compiled
-- show_statistic  function(text), opens the window of an argument of -z
function M.register(prefs, catalogue, show_statistic)
  for _, message_type in ipairs(catalogue.messages) do
    local ids, like = message_type.name .. "_ids", "yapp.like." .. message_type.name
    add_item("Decode this ID as " .. message_type.title, like, function(values)
      preferences.set { [ids] = prefs[ids] .. "," .. values[like] }
    end)
  end
  for _, row in ipairs(FILTERS) do
    local title, field = row[1], row[2]
    add_item(title, field, function(values)
      set_filter(("%s in {%s}"):format(field, values[field]))
      apply_filter()
    end)
  end
  add_item("Fault", "yapp.message.fault", function(values)
    local frame = values["yapp.reassembled.in"] or values["frame.number"]
    show_statistic("yapp,fault,frame=" .. frame)
  end)
end

return M
