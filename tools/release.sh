#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-2.0-or-later
# Makes a release of a tag: release.sh TAG [SHA256SUMS]
#
# Builds the tag's commit twice, in two folders with other rights and another time zone, and holds the second to the sums of
# the first, and to those of a build on another machine where they are given.  What is to be attached is in dist/ then, and
# this version's part of the changelog in dist/notes.md.
set -euo pipefail

cd "$(dirname "$0")/.."
tag=$1 others=${2:-}

fail() {
  echo "release: $1" >&2
  exit 1
}

repository() {
  git -c safe.directory='*' "$@"
}

version=$(sed -n 's/^local VERSION = "\(.*\)"/\1/p' yapp.lua)
[ "$tag" = "v$version" ] || fail "the tag is $tag, the version v$version"
commit=$(repository rev-parse --verify --quiet "$tag^{commit}") || fail "there is no tag $tag"
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

# The files of the commit and nothing else, in a folder of this name.
build() {
  mkdir "$work/$1"
  repository archive "$commit" | tar -x -C "$work/$1"
  SOURCE_DATE_EPOCH=$(repository log -1 --format=%ct "$commit") python3 "$work/$1/tools/dist.py" >/dev/null
}
(umask 022 && build first)
(umask 077 && TZ=Asia/Tokyo build second)

(cd "$work/second/dist" && sha256sum --check --quiet "$work/first/dist/SHA256SUMS") || fail "two builds differ"
# The workflow adds the viewer behind this script: its page has npm's packages, which are not built here.
[ -z "$others" ] || cmp <(grep -v ' yapp-viewer-' "$others") "$work/first/dist/SHA256SUMS" ||
  fail "the build on another machine differs"
rm -rf dist
mv "$work/first/dist" dist
awk -v head="## [$version]" 'index($0, "## ") == 1 {inside = index($0, head) == 1; next} inside' CHANGELOG.md >dist/notes.md
grep -q '[^[:space:]]' dist/notes.md || fail "CHANGELOG.md has nothing for $version"
cat dist/SHA256SUMS
