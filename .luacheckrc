-- SPDX-License-Identifier: GPL-2.0-or-later
-- Exactly what Wireshark 4.0 to 4.6 defines and this plugin uses; anything else is a leak.
std = "min"
max_line_length = 120 -- of tests; the plugin's own, below
read_globals = {
  "all_field_infos", "apply_filter", "apply_preferences", "Address", "ByteArray", "base", "bit", "browser_open_url", "copy_to_clipboard", "Dir",
  "Dissector", "DissectorTable", "expert", "FileHandler", "frametype", "ftypes", "get_preference", "get_version",
  "gui_enabled", "Int64", "Listener", "MENU_STAT_UNSORTED", "MENU_TOOLS_UNSORTED", "new_dialog", "NSTime", "Pref",
  "Proto", "ProtoExpert", "ProtoField", "redissect_packets", "register_filehandler", "register_menu", "register_packet_menu", "register_stat_cmd_arg",
  "report_failure", "retap_packets", "set_filter", "set_plugin_info", "set_preference", "Struct", "TextWindow", "TreeItem", "Tvb",
  "UInt64", "wtap", "wtap_encaps", "wtap_presence_flags", "wtap_rec_types", "wtap_tsprecs",
  "yapp_is_whole", -- of web/glue.lua
}
files["tests/unit"] = { read_globals = { "arg" } }
-- 13: twelve branches (if, elseif, while, for, repeat, and, or).
for _, path in ipairs { "yapp.lua", "taurus_fields.lua", "yapp" } do
  files[path] = { max_line_length = 100, max_cyclomatic_complexity = 13 }
end
-- They replace functions of the API.
files["tests/plant.lua"] = { globals = { "ProtoField", "ProtoExpert", "TreeItem", "Pref", "FileHandler", "io" }, read_globals = { "typeof", "unpack", "table" } }
files["tests/e2e/experts.lua"] = { globals = { "ProtoExpert" } }
exclude_files = { "test_captures/cases" } -- broken on purpose

-- It gives the plugin what Wireshark's windows have.
files["web/glue.lua"].globals = {
  "gui_enabled", "retap_packets", "report_failure", "register_stat_cmd_arg", "TextWindow", "register_menu",
  "register_packet_menu", "yapp_is_whole", "os.exit",
}
