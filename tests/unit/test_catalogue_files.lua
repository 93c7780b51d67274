-- SPDX-License-Identifier: GPL-2.0-or-later
-- Files of messages: the user's after the plugin's; what is wrong with one of them does not take the others along.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local cpu, levels = require("cpu"), require("levels")
local files = require("yapp.message.catalogue_files")

local T = {}

local made = {}

local function write(text)
  local path = os.tmpname()
  made[#made + 1] = path
  local file = assert(io.open(path, "wb"))
  file:write(text)
  file:close()
  return path
end

function T.tearDown()
  for _, path in ipairs(made) do os.remove(path) end
  made = {}
end

local function entry(name, id, kind)
  return ('{ name = "%s", title = "T", id = %d, size = 1, { "f", "%s", "F" } },'):format(name, id, kind or "uint8")
end

-- The names, IDs and types of what was loaded, and the problems.
local function load(...)
  local list = {}
  for i, text in ipairs { ... } do list[i] = { path = write(text) } end
  local compiled, problems = files.load(list)
  local names = {}
  for i, message in ipairs(compiled.messages) do
    names[i] = ("%s %d %s"):format(message.name, message.id, message.fields[1].type)
  end
  return table.concat(names, ", "), problems, list
end

function T.test_own_messages_and_replacements()
  local names, problems = load("return {" .. entry("a", 1) .. entry("b", 2) .. "}",
    "return {" .. entry("c", 3) .. entry("a", 7, "int8") .. "}", "return {" .. entry("c", 4) .. "}")
  lu.assertEquals({ names, problems }, { "a 7 int8, b 2 uint8, c 4 uint8", {} })
end

function T.test_messages_are_in_the_order_of_their_numbers()
  local text, expected = {}, {}
  for i = 1, 9 do
    text[i] = ("[%d] = %s"):format(10 - i, entry("m" .. 10 - i, i))
    expected[i] = ("m%d %d uint8"):format(i, 10 - i)
  end
  local names, problems = load("return {" .. table.concat(text) .. "}")
  lu.assertEquals({ names, problems }, { table.concat(expected, ", "), {} })
end

function T.test_an_error_names_file_message_and_field()
  local names, problems, list = load("return {" .. entry("a", 1) .. "}", "return {" .. entry("b", 2, "uint9") ..
    entry("c", 1) .. entry("d", 4) .. entry("d", 5) .. "}")
  lu.assertEquals(names, "a 1 uint8, d 4 uint8")
  local path = list[2].path
  lu.assertEquals(#problems, 3)
  lu.assertStrContains(problems[1], path .. ': message b, field f: unknown type "uint9"; the types are')
  lu.assertEquals(problems[2], path .. ": message c: id 0x1 is that of message a; this message is not decoded")
  lu.assertEquals(problems[3], path .. ": message d: the name is there twice; this message is not decoded")
end

-- What a file says of itself may be long, and no message without a name takes another one's place.
function T.test_long_errors_and_messages_without_a_name()
  local _, problems = load('error(("x"):rep(1000), 0)')
  lu.assertStrContains(problems[1], "cannot be read: " .. ("x"):rep(500) .. "; its messages")
  _, problems = load("return { { id = 5 } }", "return { { id = 6 } }")
  lu.assertEquals(#problems, 2)
end

function T.test_a_message_without_a_name_has_its_number_in_the_file()
  local _, problems, list = load("return {" .. entry("a", 1) .. entry("b", 2) .. "}",
    "return {" .. entry("c", 3) .. "{ id = 4 } }")
  lu.assertStrContains(problems[1], list[2].path .. ": message 2: name nil is not a filter name")
end

function T.test_a_file_that_is_no_catalogue()
  for text, said in pairs {
    ['return { name = "c", id = 3 }'] = "the file must return a list of messages, { { name = ... } }, not one",
    ["return 5"] = "the file must return a list of messages, not 5",
    [""] = "the file must return a list of messages, not nil",
    ["return {"] = "the catalogue cannot be read: ", ["error('planted')"] = ":1: planted",
    ["error({})"] = "the catalogue cannot be read: table",
    ["error()"] = "the catalogue cannot be read: " .. tostring(select(2, pcall(error))), -- 5.5 has words for nil
  } do
    local names, problems, list = load("return {" .. entry("a", 1) .. "}", text)
    lu.assertEquals({ names, #problems }, { "a 1 uint8", 1 }, text)
    lu.assertStrContains(problems[1], list[2].path)
    lu.assertStrContains(problems[1], said)
  end
end

-- What is in the list is read; what is not is said, with what to do.
function T.test_a_table_that_is_no_list()
  local keyed = ": the entry %s is not read: a message has its name inside"
  local gap = ": message %d of the list is nil: a variable that is not defined, or misspelt?"
  for text, row in pairs {
    ["a = " .. entry("b", 2)] = { "a 1 uint8", keyed:format('"a"') },
    [entry("b", 2) .. "version = 2"] = { "a 1 uint8, b 2 uint8", keyed:format('"version"') },
    ["name = " .. entry("b", 2)] = { "a 1 uint8", keyed:format('"name"') },
    ["[0] = " .. entry("b", 2)] = { "a 1 uint8", keyed:format("0") },
    ["[1.5] = " .. entry("b", 2)] = { "a 1 uint8", keyed:format("1.5") },
    ["[{}] = " .. entry("b", 2)] = { "a 1 uint8", keyed:format("a table") },
    ["nothing, " .. entry("b", 2)] = { "a 1 uint8, b 2 uint8", gap:format(1) },
    [entry("b", 2) .. "nothing, " .. entry("c", 3)] = { "a 1 uint8, b 2 uint8, c 3 uint8", gap:format(2) },
    ["[7] = " .. entry("b", 2)] = { "a 1 uint8, b 2 uint8", gap:format(1) },
    [entry("b", 2) .. "5"] = { "a 1 uint8, b 2 uint8", ": message 2: a message is a table, not 5" },
    [entry("b", 2) .. "print"] = { "a 1 uint8, b 2 uint8", ": message 2: a message is a table, not a function" },
  } do
    local names, problems, list = load("return {" .. entry("a", 1) .. "}", "return {" .. text .. "}")
    lu.assertEquals({ names, #problems }, { row[1], 1 }, text)
    lu.assertStrContains(problems[1], list[2].path .. row[2])
  end
end

function T.test_a_list_without_an_end()
  for _, text in ipairs {
    "local t = {} for i = 1, SIZE do t[i] = %s end return t",
    "local t = {} for i = 1, SIZE do t['x' .. i] = %s end return t",
    "return setmetatable({}, { __index = function() return %s end, __len = function() return 1e9 end })",
  } do
    lu.assertTrue(cpu.is_linear(function(size)
      local list = text:format(entry("b", 2):sub(1, -2)):gsub("SIZE", size)
      local names, problems = load("return {" .. entry("a", 1) .. "}", list)
      lu.assertStrContains(names, "a 1 uint8")
      lu.assertTrue(#problems <= 20, text)
    end, levels.size(8000, 25000)), text)
  end
end

function T.test_of_many_mistakes_some_are_said()
  local entries = {}
  for i = 1, 100 do entries[i] = entry("m" .. i, 9999) end
  local _, problems = load("return {" .. table.concat(entries) .. "}")
  lu.assertEquals({ #problems, problems[20] }, { 20, "and so on: 100 problems in all" })
end

function T.test_a_file_that_is_not_there()
  local path = write("return {" .. entry("a", 1) .. "}")
  local compiled, problems = files.load { { path = path }, { path = path .. ".no", optional = true } }
  lu.assertEquals({ #compiled.messages, problems }, { 1, {} })
  compiled, problems = files.load { { path = path .. ".no" }, { path = path } }
  lu.assertEquals({ #compiled.messages, problems },
    { 1, { path .. ".no: not found; its messages are not decoded" } })
end

-- By the number of the error: its text is in the user's language.
function T.test_a_file_that_may_not_be_read()
  for code, said in pairs { [13] = "cannot be read: x.lua: text", [2] = "not found", [14] = "not found" } do
    local open = io.open
    io.open = function(path) return nil, path .. ": text", code end -- luacheck: ignore 122
    local _, problems = files.load { { path = "x.lua" } }
    io.open = open -- luacheck: ignore 122
    lu.assertEquals(problems, { "x.lua: " .. said .. "; its messages are not decoded" })
  end
end

function T.test_a_preference_in_its_file()
  for text, value in pairs {
    ["yapp.messages: /a b/c.lua\n"] = "/a b/c.lua", ["x: 1\r\nyapp.messages: C:\\d.lua\r\ny: 2\r\n"] = "C:\\d.lua",
    ["# yapp.messages: no\n"] = "none", ["yapp.messages:\nx: 1\n"] = "none", ["yapp.messages: \n"] = "none",
    [""] = "none", ["a.yapp.messages: no\n"] = "none", ["yapp.messages_too: no\n"] = "none",
    ["yapp_messages: no\n"] = "none",
    ["yapp.messages: last"] = "last",
  } do
    lu.assertEquals(files.read_preference(write(text), "yapp.messages") or "none", value, text)
  end
  lu.assertNil(files.read_preference(write("") .. ".no", "yapp.messages"))
end

-- docs/catalogue.md names every option and type: an unknown one is answered with the list of those there are.
function T.test_the_page_names_every_option_and_type()
  local file = assert(io.open("docs/catalogue.md"))
  local page = file:read("*a")
  file:close()
  local entries = {}
  for _, row in ipairs { "'uint8', 'X', z = 1", "'uint9', 'X'", "'float16', 'X', z = 1", "'bytes', 'X', z = 1",
    "'variants', z = 1", "'uint8', 'X', group = 'g', flags = {{'a', 1, 'A', z = 1}}",
    "'uint8', 'X', bits = {{'a', 3, 'A', z = 1}}" } do
    entries[#entries + 1] = "{ name = 'm', title = 'M', id = 1, size = 1, { 'x', " .. row .. " } }"
  end
  for _, option in ipairs { "z = 1", "derived = {{'d', 'x * x', 'D', z = 1}}" } do
    entries[#entries + 1] = "{ name = 'm', title = 'M', id = 1, size = 1, " .. option .. ", { 'x', 'uint8', 'X' } }"
  end
  for _, entry_text in ipairs(entries) do
    local _, problems = load("return {" .. entry_text .. "}")
    local list = problems[1]:match("has ([%w_, ]+);") or problems[1]:match("the types are ([%w_, ]+);")
    for name in list:gmatch("[%w_]+") do lu.assertStrContains(page, "`" .. name .. "`") end
  end
end

return T
