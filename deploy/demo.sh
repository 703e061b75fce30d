#!/usr/bin/env bash
# Shows the whole path on sample data: installs, builds, starts a server, enrols 20 CAD parts, recognises a scene from its
# images alone, draws the result and checks it against the scene's ground truth. Not 0 when the check fails.
#
#   deploy/demo.sh [--installed] [--out FOLDER] [SCENE]   a scene of tests/data/parts/val: 1 (default), 5, 11 or 13
#                                1 and 5 must come out right, 1 with a grasp; 11 and 13 are hard and are only shown and scored
#     --installed                take the programs of the Debian packages; nothing is installed or built
#     --out FOLDER               for overlay, results and server log (default: build/demo, else a new folder in /tmp)
#   horopter-demo ...            the same of the package horopter-demo, always --installed
#
# Needs no network with --installed. Nothing is left behind but the folder. May be run as often as you like.
set -euo pipefail
began=$SECONDS
called_in=$PWD
cd "$(dirname "$(readlink -f "$0")")/.."

installed=false
[[ -e CMakeLists.txt ]] || installed=true
scene=1
out=
while [[ $# -gt 0 ]]; do
  case $1 in
    --installed) installed=true; shift ;;
    --out) out=$(cd "$called_in" && realpath -m "${2:?--out needs a folder}"); shift 2 ;;
    *) scene=$1; shift ;;
  esac
done
dataset=tests/data/parts
folder=$(printf '%s/val/%06d' "$dataset" "$scene" 2>/dev/null) && [[ -d $folder ]] || {
  sed -n '2,11s/^# \{0,1\}//p' "$0" >&2
  exit 2
}
tier=$(python3 -c 'import json, sys; print(json.load(open(sys.argv[1]))["tier"])' "$folder/scene_meta.json" 2>/dev/null ||
  grep -o 'T[0-9]' "$folder/scene_meta.json" | head -n 1)

step() { printf '\n[%d/6] %s  (%d s)\n' "$1" "$2" $((SECONDS - began)); }

if $installed; then
  horopterd=$(command -v horopterd) && horopter=$(command -v horopter) || {
    echo "demo.sh: horopterd and horopter are not installed" >&2
    exit 1
  }
else
  step 1 "packages"
  deploy/install.sh

  step 2 "build"
  deploy/build.sh horopterd horopter
  find_program() {
    local found
    found=$(find build/release -type f -name "$1" -perm -u+x -print -quit)
    [[ -n $found ]] || { echo "demo.sh: the build made no $1" >&2; exit 1; }
    echo "$found"
  }
  horopterd=$(find_program horopterd)
  horopter=$(find_program horopter)
fi

if [[ -z $out ]] && mkdir -p build/demo 2>/dev/null && [[ -w build/demo ]]; then out=$PWD/build/demo; fi
[[ -n $out ]] || out=$(mktemp -d "${TMPDIR:-/tmp}/horopter-demo-XXXXXX")
mkdir -p "$out"
rm -f "$out"/overlay-scene-*.png "$out"/{answer.txt,results*,scores.json,server.log}
temporary=$(mktemp -d)
# Nothing of this leaves the machine, and no proxy knows its server.
export no_proxy=localhost,127.0.0.1 NO_PROXY=localhost,127.0.0.1
server=
stop_server() {
  if [[ -n $server ]] && kill -TERM "$server" 2>/dev/null; then
    for _ in $(seq 100); do
      kill -0 "$server" 2>/dev/null || break
      sleep 0.1
    done
    kill -KILL "$server" 2>/dev/null || true
  fi
  wait "$server" 2>/dev/null || true
  server=
}
trap 'stop_server; rm -rf "$temporary"' EXIT
trap 'exit 130' INT
trap 'exit 143' TERM

# With TLS and tokens, as a cell would have it. Port 0: the system picks a free one and the log says which.
start_server() {
  local keys=$temporary/credentials
  deploy/credentials.sh "$keys"
  export HOROPTER_TLS_CA=$keys/ca.pem HOROPTER_TOKEN_FILE=$keys/admin.token
  "$horopterd" --db "$temporary/catalog.db" --listen 127.0.0.1:0 --tls-cert "$keys/server.pem" --tls-key "$keys/server.key" \
    --access-file "$keys/access" >"$out/server.log" 2>&1 &
  server=$!
  for _ in $(seq 300); do
    address=$(sed -n 's/.*listening on \([^ ]*\)$/\1/p' "$out/server.log")
    if [[ -n $address ]] && "$horopter" --server "$address" --timeout 2 object list >/dev/null 2>&1; then return 0; fi
    kill -0 "$server" 2>/dev/null || break
    sleep 0.1
  done
  echo "demo.sh: the server did not come up:" >&2
  cat "$out/server.log" >&2
  return 1
}

step 3 "start the server"
start_server
echo "horopterd listens on $address, catalog in a temporary file, log in $out/server.log"

step 4 "enrol the parts of $dataset"
"$horopter" --server "$address" dataset enroll "$dataset"

step 5 "recognise scene $scene ($tier) from its images"
images=("$folder"/rgb/*)
printf 'image: %s\n' "${images[@]}"
echo
"$horopter" --server "$address" recognize "${images[@]}" --out "$out/overlay-scene-$scene.png" | tee "$out/answer.txt"

step 6 "compare with the ground truth"
results=$out/results.csv
"$horopter" --server "$address" dataset recognize "$dataset" val --scenes "$scene" --out "$results"
"$horopter" dataset evaluate "$dataset" val "$results" --scenes "$scene"
"$horopter" dataset evaluate "$dataset" val "$results" --scenes "$scene" --json >"$out/scores.json"
kill -0 "$server" || { echo "demo.sh: the server died" >&2; exit 1; }
verdict=0
python3 -B deploy/demo_verdict.py "$dataset" "$scene" "$results" "$out/scores.json" || verdict=$?

if [[ $scene -eq 1 ]] && ! grep -q 'grasp_[0-9]* at (' "$out/answer.txt"; then
  echo "no grasp that a robot could take is offered"
  verdict=1
fi

echo
echo "Overlay: $out/overlay-scene-$scene.png"
if [[ $verdict -ne 0 && $tier == T1 ]]; then
  echo "Demo FAILED: scene $scene was not recognised correctly."
  exit 1
fi
[[ $verdict -eq 0 ]] && echo "Demo passed in $((SECONDS - began)) s." ||
  echo "Demo done in $((SECONDS - began)) s; scene $scene ($tier) is not fully recognised yet."
