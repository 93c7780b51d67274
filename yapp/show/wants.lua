-- SPDX-License-Identifier: GPL-2.0-or-later
-- What Wireshark wants of a packet: which of our items it shows, filters or prints, and whether it
-- has columns.  Wireshark's API.

local Wants = {}
Wants.__index = Wants

local referenced = TreeItem.referenced
local IS_TSHARK = not gui_enabled()
local NO_COLUMN = "(info)" -- the text of a column if there are no columns
-- COMPAT 4.0, 4.4: from 4.6 on `referenced` says that -z io,phs wants the names of protocols.
local NEEDS_NAMES = get_version():find("^4%.[0-5]%.") ~= nil
-- COMPAT 4.0: no filter can name a column there.
local FILTERS_COLUMNS = not get_version():find("^4%.0%.")

local LIST = { columns = true, shows = true } -- a packet list of Wireshark, or of later passes

--- Make it.
-- messages  of the catalogue
-- fields    of the messages, see show.fields
function Wants.new(messages, fields)
  local states = {}
  for _, message_type in ipairs(messages) do
    for _, filter in pairs(message_type.states) do states[#states + 1] = fields[filter] end
  end
  return setmetatable({
    states = states, -- fields that the history's state has
    first_pass = nil, -- the answer of tshark's first pass
    is_only_pass = false, -- true if it is known that there is one pass
    has_statistic = false, -- true if a statistic of ours runs, whose filters make a tree
  }, Wants)
end

--- Forget the answer about the file before.
function Wants:reset()
  self.first_pass, self.is_only_pass = nil, false
end

--- Make this first pass of tshark the only one: no packet is revisited.
function Wants:set_only_pass()
  self.first_pass, self.is_only_pass = nil, true
end

-- Return whether tshark's first pass is its only one.  The first pass of two shows no tree.  It has
-- columns only if a filter names a column, and then it builds a tree.
local function is_only_pass(tree, has_columns)
  if not tree.hidden then return has_columns end
  return tree.visible or has_columns and not (FILTERS_COLUMNS and pcall(all_field_infos))
end

-- The API takes a dissector to ask about a protocol.  YAPP's is replaced while frames come, and
-- both answers are about the protocol.
local function is_wanted(tree, name)
  return referenced(tree, Dissector.get(name))
end

-- Ask what a tree wants.
local function ask_tree(tree)
  local yapp, taurus = is_wanted(tree, "yapp"), is_wanted(tree, "taurus")
  return {
    columns = true,
    shows = true,
    yapp = yapp,
    taurus = taurus,
    tree = yapp or taurus,
    state = taurus,
    names = NEEDS_NAMES and not yapp,
  }
end

-- Ask in tshark's first pass, where the answer is the same for all packets.
local function ask_first_pass(self, tree, pinfo)
  local has_columns = tostring(pinfo.cols.info) ~= NO_COLUMN
  local wants = tree.hidden and ask_tree(tree) or {}
  wants.columns = has_columns
  wants.names = wants.names and not self.has_statistic -- of each packet: 10 % of csv
  wants.shows = has_columns or wants.tree or wants.names
  wants.is_only_pass = self.is_only_pass or is_only_pass(tree, has_columns)
  if wants.state then
    wants.state = false
    for _, field in ipairs(self.states) do
      wants.state = wants.state or referenced(tree, field)
    end
  end
  return wants
end

--- Ask which parts of a packet are wanted.
-- visited   true if the packet was shown before
-- returns   {
--   yapp          true if YAPP's own items are shown, filtered or printed
--   taurus        true if those of messages are
--   tree          true if one of the two is
--   state         true if the state of messages that change nothing is wanted, too
--   names         true if the names of the protocols are wanted although yapp is not
--   columns       true if there are columns: tshark has them for a packet list, and not with -V,
--                 -q, most of -T or in a first pass of two
--   shows         true if anything but expert items is wanted
--   is_only_pass  true if it is sure that no packet is shown again, so that nothing need be kept: a
--                 tenth of a packet list }
-- In tshark's first pass the answer is one table for all packets; in Wireshark, and in later
-- passes, it may change.
function Wants:ask(tree, pinfo, visited)
  if not tree then return { is_only_pass = self.is_only_pass } end -- a tap shows nothing
  if IS_TSHARK and not visited then
    self.first_pass = self.first_pass or ask_first_pass(self, tree, pinfo)
    return self.first_pass
  end
  return tree.hidden and ask_tree(tree) or LIST
end

return Wants
