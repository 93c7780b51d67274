-- SPDX-License-Identifier: GPL-2.0-or-later
-- The names of the statistics, in the order of stat.options: all that the start of tshark needs of
-- them.  Pure Lua.

return { "summary", "faults", "fault", "events", "compare", "buses", "csv", "check", "watch" }
