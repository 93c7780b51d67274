-- SPDX-License-Identifier: GPL-2.0-or-later
-- Loaded behind the plugin: at the end says on stderr whether the memory of CAN was told that the
-- first pass is the only one.
if not package.loaded["yapp.can.frames"] then return end -- not behind it

local told = {}
for name, module in pairs { can = "yapp.can.frames" } do
  local class = require(module)
  local new = class.new
  function class.new(...)
    local kept = new(...)
    told[#told + 1] = { name = name, kept = kept }
    return kept
  end
end
package.loaded["yapptest.kept"] = setmetatable({}, { __gc = function()
  local only = {}
  for _, one in ipairs(told) do only[one.name] = only[one.name] or one.kept.is_only_pass end
  io.stderr:write("only pass:", only.can and " can" or "", "\n")
end })
