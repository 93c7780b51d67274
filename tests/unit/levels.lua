-- SPDX-License-Identifier: GPL-2.0-or-later
-- How much the pure tests do: YAPP_LEVEL says it, as in tests/e2e/levels.py.
local M = {}

local ALL = os.getenv("YAPP_LEVEL") == "all"

--- So many random cases, bytes or rounds: the second only where everything is done.
function M.size(some, many)
  return ALL and many or some
end

return M
