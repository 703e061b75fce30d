#!/usr/bin/env bash
# Goes the operator's way in a browser: from a STEP file and four photographs to a drawing over them, with the real server; checks
# each page with axe-core and photographs it. Skipped, with words and exit code 77, where chromium, node or the page is not there.
#
#   console/test.sh [--build FOLDER] [--out FOLDER]
#     --build FOLDER   default: build/release
#     --out FOLDER     for the screenshots (default: FOLDER of the build, console/screens)
set -euo pipefail
cd "$(dirname "$0")/.."

build=build/release
out=
while [[ $# -gt 0 ]]; do
  case $1 in
    --build) build=${2:?--build needs a folder}; shift 2 ;;
    --out) out=${2:?--out needs a folder}; shift 2 ;;
    *) sed -n '2,8s/^# \{0,1\}//p' "$0" >&2; exit 2 ;;
  esac
done
build=$(realpath "$build")
out=$(realpath -m "${out:-$build/console/screens}")
skip() { echo "console/test.sh: skipped: $*"; exit 77; }

chromium=$(command -v chromium || command -v chromium-browser) || skip "no chromium"
command -v node >/dev/null || skip "no node"
[[ -e $build/console/page/index.html ]] || skip "the page is not built (no npm, or no network for it)"
modules=$build/console/web/node_modules
[[ -e $modules/playwright-core ]] || skip "playwright-core is not installed"

# What a browser fetches.
bytes=0
for file in "$build"/console/page/index.html "$build"/console/page/assets/*; do bytes=$((bytes + $(gzip -9c "$file" | wc -c))); done
echo "the page has $bytes bytes, gzipped"
[[ $bytes -le 400000 ]] || { echo "console/test.sh: that is more than 400 kB" >&2; exit 1; }

for test in "$build"/console/web/tests/*_test.ts; do
  (cd "$build/console/web" && node_modules/.bin/esbuild "$test" --bundle --platform=node --format=cjs --log-level=warning \
    --define:location.origin='"http://localhost"' | node)
done

work=$(mktemp -d "${TMPDIR:-/tmp}/horopter-console-XXXXXX")
pids=()
trap 'kill "${pids[@]}" $(cat "$work/server.pid" 2>/dev/null) 2>/dev/null || true; wait 2>/dev/null || true; rm -rf "$work"' EXIT
# Prints the address that a program says it serves on.
await() {
  for _ in $(seq 600); do
    local found
    found=$(sed -n "s/.*$2 \([0-9a-z.:]*:[0-9]*\).*/\1/p" "$1" | tail -n 1)
    [[ -z $found ]] || { echo "$found"; return; }
    sleep 0.1
  done
  cat "$1" >&2
  return 1
}
token=$(od -An -N16 -tx1 /dev/urandom | tr -d ' \n')
(umask 077; printf 'admin operator sha256:%s\n' "$(printf %s "$token" | sha256sum | cut -d' ' -f1)" >"$work/access")
serving=(--db "$work/parts.db" --access-file "$work/access" --record-dir "$work/recordings" --record-sample 1)
"$build/bin/horopterd" --listen localhost:0 "${serving[@]}" >"$work/server.log" 2>&1 &
pids+=($!)
server=$(await "$work/server.log" "listening on")
"$build/bin/horopter-console" --listen 127.0.0.1:0 --server "$server" --page "$build/console/page" >"$work/console.log" 2>&1 &
pids+=($!)
console=$(await "$work/console.log" "serving browsers on")
mkdir -p "$out"
export HOROPTER_PROGRAM=$build/client/horopter HOROPTER_SERVER=$server HOROPTER_TOKEN=$token
# For the walk, which stops the server and starts it again: server.pid is then the one that runs.
export HOROPTERD=$build/bin/horopterd HOROPTERD_PID=${pids[0]} HOROPTERD_ARGUMENTS
HOROPTERD_ARGUMENTS=$(printf '%s\n' --listen "$server" "${serving[@]}")
NODE_PATH=$modules node console/walk.cjs "http://$console" "$chromium" "$PWD/tests/data" "$out" "$work"
# What the page saved is a recording. The walk took the token away at its end and gave it back, which the server sees within a second.
recording=$(ls "$work"/*.horec)
for _ in $(seq 50); do
  "$HOROPTER_PROGRAM" object list >/dev/null 2>&1 && break
  sleep 0.2
done
"$HOROPTER_PROGRAM" replay "$recording" >"$work/replay.log" 2>&1 || {
  cat "$work/replay.log"
  exit 1
}
tail -n 1 "$work/replay.log"
