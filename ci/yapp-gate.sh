#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-2.0-or-later
# Judges captures in a CI job: yapp-gate.sh [OPTION...] CAPTURE...
#
# A capture is a file, or a pattern in quotes, such as 'flights/*.pcapng'.  Of several, it prints what does not hold, and a
# table of rules by captures.
#
#   --rules R           as after -z yapp,check, such as fault=0,motor.rate=9, or a file of rules; without them all is checked
#   --sources S         the preference yapp.sources: "can0/0x210=motor:left,can1/0x210=motor:right"
#   --messages FILE     a file of your own messages
#   --junit FILE        where a test report is to be written; of several captures with a suite for each
#   --summary FILE      a table in Markdown is appended, as to $GITHUB_STEP_SUMMARY
#   --waive FILE        what may fail: lines CAPTURE-PATTERN RULE SOURCE until=2027-01-31 why
#   --preferences FILE  a file of Wireshark's preferences, as in its configuration folder
#   -o NAME:VALUE       a preference; may be given again
#   -d TABLE==VALUE,PROTOCOL  Decode As, such as tcp.port==4001,yapp_serial; may be given again
#   --report FOLDER     a folder for FOLDER/report.html, which opens in any browser: the rules, and the capture at each that
#                       failed.  It takes dist/viewer-offline, or runs `make viewer`, which installs what it needs.
#
# It ends with tshark's exit code, of several captures with the worst: 20 a rule does not hold, others: no capture, or a damaged
# one, no tshark, no plugin; 21 a rule could not be judged, 0 all rules hold.  An empty value is none.  tshark is installed where there is none (Debian, Ubuntu);
# nothing else is without --report, and no setting of the user's has a say.  The plugin is the one beside this script's folder.
set -euo pipefail

TOP=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)

refuse() {
  echo "yapp-gate: $1" >&2
  exit 2
}

install_tshark() {
  local root=()
  [ "$(id -u)" = 0 ] || root=(sudo)
  command -v apt-get >/dev/null || refuse "no tshark: install Wireshark 4.0 or later"
  [ ${#root[@]} = 0 ] || command -v sudo >/dev/null || refuse "no tshark, and no sudo: as root, apt-get install tshark"
  { "${root[@]}" apt-get update -qq && "${root[@]}" env DEBIAN_FRONTEND=noninteractive \
    apt-get install -y -qq --no-install-recommends tshark; } >/dev/null || refuse "tshark could not be installed"
}

# Write a file as a script that the viewer can load from a disk: embed FILE NAME
embed() {
  { printf 'asset("%s", "' "$2"; base64 -w 0 "$1"; printf '");\n'; } >"$report/$2.js"
}

# Encode a text for a link.
encode() {
  local LC_ALL=C text=$1 one i
  for ((i = 0; i < ${#text}; i++)); do
    one=${text:i:1}
    case $one in [A-Za-z0-9._-]) printf %s "$one" ;; *) printf '%%%02X' "'$one" ;; esac
  done | sed 's/%FFFFFFFFFFFFFF/%/g' # of a byte above 127
}

# Make the page: the viewer, the captures, and a link to each.
write_report() {
  local viewer=$TOP/dist/viewer-offline name link text options_text='' head='' links='' number
  if ! { [ -d "$viewer" ] || make -s -C "$TOP" viewer >&2; }; then
    echo "yapp-gate: no report: the viewer could not be made; run make viewer in $TOP, which says why" >&2
    [ "$code" != 0 ] || code=21
    return
  fi
  mkdir -p "$report"
  cp -r "$viewer/." "$report/"
  text=$rules
  [ ! -f "$work/rules.txt" ] || text=$(sed 's/#.*//' "$work/rules.txt" | tr '\n' ,)
  options_text="&statistic=check$(encode "${text:+,$text}")"
  # What it has no link for is Decode As, and preferences that are not YAPP's.
  while read -r text; do
    case $text in yapp.*:*) options_text+="&$(encode "${text%%:*}")=$(encode "$(sed 's/^[^:]*: *//' <<<"$text")")" ;; esac
  done < <([ -z "$preferences" ] || cat "$preferences"; printf '%s\n' "${options[@]}" ${sources:+"yapp.sources:$sources"})
  if [ -n "$messages" ]; then
    embed "$messages" yapp_messages.lua
    options_text+="&messages=yapp_messages.lua"
  fi
  for number in "${!captures[@]}"; do
    name=$(basename "${captures[number]}" | tr -c 'A-Za-z0-9._\n-' _)
    [ ${#captures[@]} = 1 ] || name=$((number + 1))-$name
    embed "${captures[number]}" "$name"
    link="index.html#file=$name$options_text"
    [ ${#captures[@]} != 1 ] || head="<meta http-equiv=\"refresh\" content=\"0; url=$link\">"
    links+="<p><a href=\"$link\">The report of $name</a>"$'\n'
  done
  printf '<!DOCTYPE html>\n<meta charset="utf-8">\n%s\n%s' "$head" "$links" | sed 's/&\([a-z]\)/\&amp;\1/g' >"$report/report.html"
}

# Find the captures of an argument: a file or a pattern a line.
find_captures() {
  local line found
  while read -r line; do
    found=()
    if [ -e "$line" ]; then found=("$line"); else mapfile -t found < <(compgen -G "$line" | sort); fi
    [ ${#found[@]} != 0 ] || refuse "${line:-an empty name} is no file that can be read"
    captures+=("${found[@]}")
  done <<<"$1"
}

OPTIONS="--rules, --sources, --messages, --junit, --summary, --waive, --report, --preferences, -o and -d"
rules='' sources='' messages='' junit='' summary='' waivers='' report='' preferences='' captures=() options=()
while [ $# -gt 0 ]; do
  [[ $1 != -* || $# -gt 1 ]] || refuse "$1: its value is missing; options are $OPTIONS"
  case $1 in
    --rules) rules=$2; shift ;;
    --sources) sources=$2; shift ;;
    --messages) messages=$2; shift ;;
    --junit) junit=$2; shift ;;
    --summary) summary=$2; shift ;;
    --waive) waivers=$2; shift ;;
    --report) report=$2; shift ;;
    --preferences) preferences=$2; shift ;;
    -o)
      [[ $2 == *?:* ]] || refuse "-o $2: a preference is NAME:VALUE, such as yapp.motor_ids:0x210-0x213"
      [[ $2 != yapp.messages:* ]] || refuse "-o yapp.messages is read too late: use --messages FILE"
      options+=("$1" "$2"); shift ;;
    -d)
      [[ $2 == ?*,?* ]] || refuse "-d $2: Decode As is TABLE==VALUE,PROTOCOL, such as tcp.port==4001,yapp_serial"
      options+=("$1" "$2"); shift ;;
    -*) refuse "$1 is no option; options are $OPTIONS" ;;
    *) find_captures "$1" ;;
  esac
  shift
done
[ ${#captures[@]} != 0 ] || refuse "no capture is named"
for file in "${captures[@]}" ${messages:+"$messages"} ${preferences:+"$preferences"} ${waivers:+"$waivers"}; do
  [ -f "$file" ] && [ -r "$file" ] || refuse "$file is no file that can be read"
done
command -v tshark >/dev/null || install_tshark

printf -v today '%(%F)T' -1
export today
work='' waivers=$waivers awk -f "$TOP/ci/verdicts.awk" # are the waivers good?

# A folder that an ordinary user can read: as root, Wireshark 4.4 and later run no plugin.
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
mkdir "$work/home" "$work/plugin"
cp -r "$TOP/yapp.lua" "$TOP/taurus_fields.lua" "$work/plugin/"
[ ! -d "$TOP/yapp" ] || cp -r "$TOP/yapp" "$work/plugin/"
for number in "${!captures[@]}"; do
  mkdir "$work/$((number + 1))"
  cp "${captures[number]}" "$work/$((number + 1))/"
done
[ -z "$messages" ] || cp "$messages" "$work/messages.lua"
if [ -f "$rules" ]; then
  cp "$rules" "$work/rules.txt"
  rules=rules=rules.txt
elif [ -n "$rules" ] && [[ $rules != *=* && $rules != json ]]; then
  refuse "--rules $rules: no such file, and no rule, which is NAME=LIMIT such as fault=0"
fi
if [ -n "$preferences" ]; then
  mkdir -p "$work/home/.config/wireshark"
  cp "$preferences" "$work/home/.config/wireshark/preferences"
fi
user=()
if [ "$(id -u)" = 0 ]; then
  chown -R 65534:65534 "$work"
  user=(setpriv --reuid=65534 --regid=65534 --clear-groups)
fi

# TCP may deliver segments late; the plugin reads sequence numbers, and this makes Wireshark's own tree of them right, too.
command=(tshark -q -X "lua_script:$work/plugin/yapp.lua" -o tcp.reassemble_out_of_order:TRUE)
[ -z "$sources" ] || command+=(-o "yapp.sources:$sources")
command+=(${options[@]+"${options[@]}"}) # behind it: a hint that names sources has those that there are, too

# Judge the capture of a number.  Its exit code, output and report stand in the folder of the number.
judge() {
  local code=0 folder=$work/$1 name
  name=$(basename "${captures[$1 - 1]}")
  (
    cd "$work"
    unset XDG_CONFIG_HOME YAPP_MESSAGES
    export HOME=$work/home
    [ -z "$messages" ] || export YAPP_MESSAGES=$work/messages.lua
    "${user[@]}" "${command[@]}" -r "$folder/$name" -z "yapp,check${rules:+,$rules},junit=$1/report.xml"
  ) >"$folder/out" 2>"$folder/err" || code=$?
  echo "$code" >"$folder/code"
}

# Several at a time.
running=0
for number in "${!captures[@]}"; do
  [ "$((running++))" -lt "$(nproc)" ] || wait -n
  judge "$((number + 1))" &
done
wait

for number in "${!captures[@]}"; do
  echo "$(cat "$work/$((number + 1))/code") ${captures[number]}" >>"$work/captures"
done
work=$work waivers=$waivers awk -f "$TOP/ci/verdicts.awk"
mapfile -t codes <"$work/codes"
code=0
for number in "${!captures[@]}"; do
  own=${codes[number]} folder=$work/$((number + 1))
  if [ ${#captures[@]} != 1 ] && { [ "$own" != 0 ] || [ -s "$folder/err" ]; }; then
    printf '%s: %s\n' "${captures[number]}" "$own"
    grep -E '^(check|FAILED|NOT JUDGED) ' "$folder/out" || true
  elif [ ${#captures[@]} = 1 ]; then
    cat "$folder/out"
  fi
  cat "$folder/err" >&2
  # The worst: 20, then what tshark could not read, then 21.
  for worst in 20 14 3 2 1 21; do
    if [ "$own" = "$worst" ] || [ "$code" = "$worst" ]; then
      code=$worst
      break
    fi
  done
done
if [ ${#captures[@]} != 1 ] || [ -n "$waivers" ]; then
  printf '\n'
  cat "$work/table.txt"
fi
[ -z "$summary" ] || cat "$work/table.md" >>"$summary"
if [ -n "$junit" ]; then
  mkdir -p "$(dirname "$junit")"
  cat "$work/junit.xml" >"$junit"
fi
[ -z "$report" ] || write_report
exit "$code"
