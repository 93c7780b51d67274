-- SPDX-License-Identifier: GPL-2.0-or-later
-- Files that are written aside and get their names when they are whole: nobody ever reads half of one.
-- Pure Lua, 5.2 and 5.4.

local M = {}

local ASIDE = ".part"
local DEVICES = "^/dev/" -- a file in their place would be the end of them: they are written as they are
local FULL = 65536 -- bytes that wait before they are written

local File = {}
File.__index = File

--- Whether a file can be opened.
function M.exists(path)
  local file = io.open(path, "rb")
  if file then file:close() end
  return file ~= nil
end

--- Begins a file.
-- returns  the file; nil and why not
function M.create(path)
  local aside = path:find(DEVICES) and path or path .. ASIDE
  local handle, problem = io.open(aside, "wb")
  if not handle then return nil, problem end
  return setmetatable({ path = path, aside = aside, handle = handle, waiting = {}, count = 0, size = 0 }, File)
end

local function write_out(self)
  local ok, problem = self.handle:write(table.concat(self.waiting, "", 1, self.count))
  self.count, self.size = 0, 0
  if not ok then self.problem = self.problem or problem end
end

--- Adds a text.  What goes wrong is said by File:close.
function File:write(text)
  local count = self.count + 1
  self.count, self.waiting[count], self.size = count, text, self.size + #text
  if self.size > FULL then write_out(self) end
end

--- Ends the file, still aside.
-- returns  true; nil and what went wrong
function File:close()
  write_out(self)
  local flushed, flush_problem = self.handle:flush()
  local closed, close_problem = self.handle:close()
  local problem = self.problem or not flushed and flush_problem or not closed and close_problem
  if problem then return nil, ("%s: %s"):format(self.path, problem) end
  return true
end

--- Gives a closed file its name, in place of one that is there.
-- returns  true; nil and what went wrong
function File:publish()
  if self.aside == self.path then return true end
  local ok, problem = os.rename(self.aside, self.path)
  local other = not ok and io.open(self.path, "ab") -- a file, no folder
  if other then -- Windows puts no file in the place of another
    other:close()
    os.remove(self.path)
    ok, problem = os.rename(self.aside, self.path)
  end
  if not ok then return nil, ("%s: %s"):format(self.path, problem) end
  self.is_published = true
  return true
end

--- Leaves nothing of a file.
function File:discard()
  if io.type(self.handle) == "file" then self.handle:close() end
  if self.aside ~= self.path then os.remove(self.is_published and self.path or self.aside) end
end

--- Ends files and gives them their names, all or, where one fails, none.
-- returns  true; nil and what went wrong
function M.finish(list)
  local ok, problem = true, nil
  for _, file in ipairs(list) do
    local closed, why = file:close()
    if ok and not closed then ok, problem = nil, why end
  end
  for _, file in ipairs(list) do
    if ok then ok, problem = file:publish() end
  end
  if ok then return true end
  for _, file in ipairs(list) do file:discard() end
  return nil, problem
end

return M
