#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-2.0-or-later
# Judges a capture in a CI job: yapp-gate.sh [OPTION...] CAPTURE
#
#   --rules R           as after -z yapp,check, such as fault=0,motor.rate=9, or a file of rules; without them all is checked
#   --sources S         the preference yapp.sources: "can0/0x210=motor:left,can1/0x210=motor:right"
#   --messages FILE     a file of your own messages
#   --junit FILE        where a test report is to be written
#   --preferences FILE  a file of Wireshark's preferences, as in its configuration folder
#   -o NAME:VALUE       a preference; may be given again
#   -d TABLE==VALUE,PROTOCOL  Decode As, such as tcp.port==4001,yapp_serial; may be given again
#   --report FOLDER     a folder for FOLDER/report.html, which opens in any browser: the rules, and the capture at each that
#                       failed.  It takes dist/viewer-offline, or runs `make viewer`, which installs what it needs.
#
# It ends with tshark's exit code: 0 all rules hold, 20 one does not, 21 one could not be judged, others: no capture, or a
# damaged one, no tshark, no plugin.  An empty value is none.  tshark is installed where there is none (Debian, Ubuntu);
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

# Make the page: the viewer, the capture, and a link to both.
write_report() {
  local viewer=$TOP/dist/viewer-offline name link text
  if ! { [ -d "$viewer" ] || make -s -C "$TOP" viewer >&2; }; then
    echo "yapp-gate: no report: the viewer could not be made; run make viewer in $TOP, which says why" >&2
    [ "$code" != 0 ] || code=21
    return
  fi
  mkdir -p "$report"
  cp -r "$viewer/." "$report/"
  name=$(basename "$capture" | tr -c 'A-Za-z0-9._\n-' _)
  embed "$capture" "$name"
  text=$rules
  [ ! -f "$work/rules.txt" ] || text=$(sed 's/#.*//' "$work/rules.txt" | tr '\n' ,)
  link="index.html#file=$name&statistic=check$(encode "${text:+,$text}")"
  # What it has no link for is Decode As, and preferences that are not YAPP's.
  while read -r text; do
    case $text in yapp.*:*) link+="&$(encode "${text%%:*}")=$(encode "$(sed 's/^[^:]*: *//' <<<"$text")")" ;; esac
  done < <([ -z "$preferences" ] || cat "$preferences"; printf '%s\n' "${options[@]}" ${sources:+"yapp.sources:$sources"})
  if [ -n "$messages" ]; then
    embed "$messages" yapp_messages.lua
    link+="&messages=yapp_messages.lua"
  fi
  printf '<!DOCTYPE html>\n<meta charset="utf-8">\n<meta http-equiv="refresh" content="0; url=%s">\n<a href="%s">%s</a>\n' \
    "$link" "$link" "The report of $name" | sed 's/&\([a-z]\)/\&amp;\1/g' >"$report/report.html"
}

OPTIONS="--rules, --sources, --messages, --junit, --report, --preferences, -o and -d"
rules='' sources='' messages='' junit='' report='' preferences='' capture='' options=()
while [ $# -gt 0 ]; do
  [[ $1 != -* || $# -gt 1 ]] || refuse "$1: its value is missing; options are $OPTIONS"
  case $1 in
    --rules) rules=$2; shift ;;
    --sources) sources=$2; shift ;;
    --messages) messages=$2; shift ;;
    --junit) junit=$2; shift ;;
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
    *) [ -z "$capture" ] || refuse "one capture at a time: $capture, $1"; capture=$1 ;;
  esac
  shift
done
[ -n "$capture" ] || refuse "no capture is named"
for file in "$capture" ${messages:+"$messages"} ${preferences:+"$preferences"}; do
  [ -f "$file" ] && [ -r "$file" ] || refuse "$file is no file that can be read"
done
command -v tshark >/dev/null || install_tshark

# A folder that an ordinary user can read: as root, Wireshark 4.4 and later run no plugin.
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
mkdir "$work/home" "$work/plugin" "$work/capture"
cp -r "$TOP/yapp.lua" "$TOP/taurus_fields.lua" "$work/plugin/"
[ ! -d "$TOP/yapp" ] || cp -r "$TOP/yapp" "$work/plugin/"
cp "$capture" "$work/capture/"
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

statistic=yapp,check${rules:+,$rules}${junit:+,junit=report.xml}
# TCP may deliver segments late; the plugin reads sequence numbers, and this makes Wireshark's own tree of them right, too.
command=(tshark -q -X "lua_script:$work/plugin/yapp.lua" -o tcp.reassemble_out_of_order:TRUE
  -r "$work/capture/$(basename "$capture")" -z "$statistic")
[ -z "$sources" ] || command+=(-o "yapp.sources:$sources")
command+=(${options[@]+"${options[@]}"}) # behind it: a hint that names sources has those that there are, too
code=0
(
  cd "$work"
  unset XDG_CONFIG_HOME YAPP_MESSAGES
  export HOME=$work/home
  [ -z "$messages" ] || export YAPP_MESSAGES=$work/messages.lua
  "${user[@]}" "${command[@]}"
) || code=$?
if [ -f "$work/report.xml" ]; then
  mkdir -p "$(dirname "$junit")"
  cat "$work/report.xml" >"$junit"
fi
[ -z "$report" ] || write_report
exit "$code"
