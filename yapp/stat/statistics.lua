-- SPDX-License-Identifier: GPL-2.0-or-later
-- The statistics, one row each.  -z yapp,NAME, the errors of options, Wireshark's menus and their
-- help, and the tests come from these rows.  Pure Lua, 5.2 to 5.5.
--
-- A new statistic is a row here and its module.

local check = require("yapp.stat.check")
local csv = require("yapp.stat.csv")
local events = require("yapp.stat.events")
local summary = require("yapp.stat.summary")

local M = {}

-- name     behind -z yapp,
-- title    in menus
-- new      function(options, context), makes it: see stat.queue
-- options  what it takes besides filter=EXPRESSION, for errors
-- help     what it says, for people
-- ask      what a menu asks for; the answer goes behind the name
-- file     the name of a new file that a menu suggests
-- is_data  whether its output has no room for notes
M.LIST = {
  {
    name = "summary",
    title = "Summary",
    new = summary.new,
    options = "json",
    help = "of each controller: rate, gaps, losses, its values",
  },
  {
    name = "faults",
    title = "Faults",
    new = events.new,
    options = "json",
    help = "when each fault rose and fell",
  },
  {
    name = "events",
    title = "Events",
    new = events.new,
    options = "json",
    help = "these, reboots, silences, bad CRCs, losses, in order",
  },
  {
    name = "compare",
    title = "Compare",
    new = summary.compare,
    options = "json",
    help = "the values of all controllers beside each other",
  },
  {
    name = "csv",
    title = "Export tables",
    new = csv.new,
    options = "replace, all, json",
    help = "a CSV for each message, in a new folder",
    ask = "New folder",
    file = "tables",
    is_data = true,
  },
  {
    name = "check",
    title = "Check",
    new = check.new,
    options = "json, junit=FILE, source=NAME, rules=FILE",
    help = "whether all is well, or rules hold",
    ask = "Rules (empty: check everything)",
  },
}

--- The rows by name.
M.BY_NAME = {}
for _, row in ipairs(M.LIST) do M.BY_NAME[row.name] = row end

return M
