-- SPDX-License-Identifier: GPL-2.0-or-later
-- How much the pure tests do: YAPP_LEVEL says it, as in tests/e2e/levels.py.
local M = {}

local LEVEL = os.getenv("YAPP_LEVEL")
local whole = LEVEL == "all" or LEVEL == "version"

--- So many random cases, bytes or rounds: in the levels quick and route, and in version and all.
function M.size(some, many)
  return whole and many or some
end

return M
