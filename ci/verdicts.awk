# SPDX-License-Identifier: GPL-2.0-or-later
# The verdicts of yapp-gate.sh on its captures, out of the test reports of tshark: what is waived, one report for all, a table
# of rules by captures, the exit code of each.
#
# In the environment:
#   work     a folder: captures = a line "CODE NAME" for each capture, N/report.xml = the report of the Nth; empty to check waivers
#   waivers  a file, or empty; today = 2026-11-28
#
# It writes work/junit.xml, work/table.txt, work/table.md and work/codes, and on stderr what waivers did not do.

function glob(pattern) {
  gsub(/[][\\.^$+(){}|]/, "\\\\&", pattern)
  gsub(/\*/, ".*", pattern)
  gsub(/\?/, ".", pattern)
  return "^" pattern "$"
}

function say(text) { print "yapp-gate: " text >"/dev/stderr" }

function is_date(text) { return text ~ /^[0-9][0-9][0-9][0-9]-[0-9][0-9]-[0-9][0-9]$/ }

# Lines are CAPTURE-PATTERN RULE SOURCE until=2027-01-31 why.
function read_waivers(   line, number, words, place) {
  while (waivers != "" && (getline line <waivers) > 0) {
    number++
    if (line ~ /^[ \t]*(#|\r?$)/) continue
    place = waivers ":" number
    sub(/\r$/, "", line)
    if (split(line, words) < 5 || words[4] !~ /^until=/ || !is_date(substr(words[4], 7))) {
      say(place ": a waiver is CAPTURE-PATTERN RULE SOURCE until=2027-01-31 why")
      exit is_refused = 1
    }
    waiver_count++
    waiver_place[waiver_count] = place
    capture_glob[waiver_count] = glob(words[1])
    rule_glob[waiver_count] = glob(words[2])
    source_glob[waiver_count] = glob(words[3])
    waiver_end[waiver_count] = substr(words[4], 7)
    sub(/^[ \t]*([^ \t]+[ \t]+)/, "", line); sub(/^[^ \t]+[ \t]+/, "", line)
    sub(/^[^ \t]+[ \t]+/, "", line); sub(/^[^ \t]+[ \t]+/, "", line)
    waiver_why[waiver_count] = line
  }
}

# Return the number of a waiver for a verdict, 0 for none.
function waiver_of(capture, rule, source,   base, first, name, i) {
  base = capture; sub(/.*\//, "", base)
  first = rule; sub(/ .*/, "", first) # without its suffixes
  name = first; sub(/=.*/, "", name)
  gsub(/ /, "/", source) # can0/0x210
  for (i = 1; i <= waiver_count; i++) {
    if (capture !~ capture_glob[i] && base !~ capture_glob[i]) continue
    if (rule !~ rule_glob[i] && first !~ rule_glob[i] && name !~ rule_glob[i]) continue
    if (source !~ source_glob[i]) continue
    if (waiver_end[i] < today) { is_expired[i] = 1; continue }
    is_used[i] = 1
    return i
  }
  return 0
}

function escaped(text) {
  gsub(/&/, "\\&amp;", text); gsub(/</, "\\&lt;", text); gsub(/>/, "\\&gt;", text); gsub(/"/, "\\&quot;", text)
  return text
}

function plain(text) {
  gsub(/&lt;/, "<", text); gsub(/&gt;/, ">", text); gsub(/&quot;/, "\"", text); gsub(/&amp;/, "\\&", text)
  return text
}

# Set rule and source of the name of a case: "motor.rate=9 can0 0x210 left", "clock=0", or a problem.
function split_name(name,   i, count, words, rest) {
  rule = name; source = "-"
  if (name !~ /^[a-z][^ =]*=/) return
  count = split(name, words, " ")
  rule = words[1]
  for (i = 2; i <= count && words[i] ~ /^(when|after|for)=/; i++) rule = rule " " words[i]
  for (; i <= count; i++) {
    rest = rest == "" ? words[i] : rest " " words[i]
    if (words[i] ~ /^0x[0-9a-f]+$/ && i < count) rest = ""
  }
  if (rest != "") source = rest
}

# Note a verdict in the table: the worst of all sources, with their names.
function add_verdict(capture, rule, source, rank) {
  if (!(rule in rows)) { rows[rule] = ++row_count; row_names[row_count] = rule }
  if (rank > ranks[rule, capture]) { ranks[rule, capture] = rank; sources[rule, capture] = "" }
  if (rank == ranks[rule, capture] && rank > 1 && source != "-") sources[rule, capture] = sources[rule, capture] " " source
  if (rank > worst[capture]) worst[capture] = rank
}

function cell_of(rule, capture,   rank) {
  rank = ranks[rule, capture]
  return WORDS[rank] sources[rule, capture]
}

# Read the report of a capture; return its suite.
function read_report(number, code, capture,   path, line, name, kind, lines, waiver, failed, errors, skipped, count, has) {
  path = work "/" number "/report.xml"
  while ((getline line <path) > 0) {
    if (line !~ /<testcase /) continue
    count++
    name = line; sub(/.* name="/, "", name); sub(/".*/, "", name)
    split_name(plain(name))
    kind = line ~ /<failure / ? 4 : line ~ /<error / ? 3 : 1
    waiver = kind > 1 ? waiver_of(capture, rule, source) : 0
    if (waiver) {
      sub(/<(failure|error) message="/, "<skipped message=\"waived until " waiver_end[waiver] ": " \
        escaped(waiver_why[waiver]) ": ", line)
      kind = 2
    }
    failed += kind == 4; errors += kind == 3; skipped += kind == 2
    lines = lines line "\n"
    add_verdict(capture, rule, source, kind)
  }
  close(path)
  has = failed ? 20 : errors ? 21 : skipped ? 0 : code
  if (code == 20 || code == 21) code = has
  if (code != 0 && code != 20 && code != 21) {
    count++; errors++
    lines = lines "  <testcase classname=\"yapp.check\" name=\"tshark\"><error message=\"it ended with " code "\"/></testcase>\n"
    add_verdict(capture, "tshark", code, 3)
  }
  print code >(work "/codes")
  # No sprintf around the lines: mawk's holds 8192 bytes.
  return sprintf("<testsuite name=\"%s\" tests=\"%d\" failures=\"%d\" errors=\"%d\" skipped=\"%d\">\n",
    escaped(captures > 1 ? capture : "yapp.check"), count, failed, errors, skipped) lines "</testsuite>\n"
}

# The columns of the table: each capture, or of many those in which a rule does not hold, and the others as one.
function choose_columns(   i, held) {
  for (i = 1; i <= captures; i++) {
    if (captures > MAX_COLUMNS && worst[names[i]] == 1) held++
    else { columns[++column_count] = names[i]; titles[column_count] = names[i] }
    if (held == 1 && !others) others = names[i]
  }
  if (held) { columns[++column_count] = others; titles[column_count] = held " others" }
}

function print_tables(   i, j, cells, widths, line, marks) {
  choose_columns()
  for (i = 0; i <= row_count; i++) {
    cells[i, 0] = i ? row_names[i] : "rule"
    for (j = 1; j <= column_count; j++) cells[i, j] = i ? cell_of(row_names[i], columns[j]) : titles[j]
    for (j = 0; j <= column_count; j++) if (length(cells[i, j]) > widths[j]) widths[j] = length(cells[i, j])
  }
  for (i = 0; i <= row_count; i++) {
    line = ""; marks = "|"
    for (j = 0; j <= column_count; j++) {
      line = line sprintf("%-" widths[j] + 2 "s", cells[i, j])
      gsub(/\|/, "\\|", cells[i, j])
      marks = marks " " (j || !i ? cells[i, j] : "`" cells[i, j] "`") " |"
    }
    sub(/ +$/, "", line)
    print line >(work "/table.txt")
    print marks >(work "/table.md")
    if (i == 0) { gsub(/[^|]+/, "---", marks); print marks >(work "/table.md") }
  }
}

BEGIN {
  MAX_COLUMNS = 12
  work = ENVIRON["work"]; waivers = ENVIRON["waivers"]; today = ENVIRON["today"]
  WORDS[0] = ""; WORDS[1] = "ok"; WORDS[2] = "waived"; WORDS[3] = "NOT JUDGED"; WORDS[4] = "FAILED"
  read_waivers()
  if (work == "") exit
  while ((getline line <(work "/captures")) > 0) {
    captures++
    codes[captures] = line + 0
    sub(/^[0-9]+ /, "", line)
    names[captures] = line
  }
  for (number = 1; number <= captures; number++) suites = suites read_report(number, codes[number], names[number])
  if (captures > 1) suites = "<testsuites name=\"yapp.check\">\n" suites "</testsuites>\n"
  printf "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n%s", suites >(work "/junit.xml")
  print_tables()
  for (i = 1; i <= waiver_count; i++) {
    if (is_expired[i]) say(waiver_place[i] ": expired on " waiver_end[i] ": " waiver_why[i])
    else if (!is_used[i]) say(waiver_place[i] ": unused: " waiver_why[i])
  }
}

END { if (is_refused) exit 2 }
