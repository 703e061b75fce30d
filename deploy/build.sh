#!/usr/bin/env bash
# Configures a preset and builds it.
#
#   deploy/build.sh [--preset NAME] [--precompiled] [TARGET...]
#     --preset NAME   a configure preset of CMakePresets.json (default: release)
#     --precompiled   with precompiled headers
#     TARGET          what to build (default: everything)
set -euo pipefail
cd "$(dirname "$0")/.."

preset=release
targets=()
options=()
while [[ $# -gt 0 ]]; do
  case $1 in
    --preset) preset=${2:?--preset needs a name}; shift 2 ;;
    --precompiled) options=(-DHOROPTER_PRECOMPILED_HEADERS=ON); shift ;;
    -*) sed -n '2,8s/^# \{0,1\}//p' "$0" >&2; exit 2 ;;
    *) targets+=("$1"); shift ;;
  esac
done

# A compiler cache in a home folder that cannot be written would end every compilation.
cache=${CCACHE_DIR:-${XDG_CACHE_HOME:-${HOME:-/nonexistent}/.cache}/ccache}
if [[ -z ${CCACHE_DIR:-} && -d ${HOME:-/nonexistent}/.ccache ]]; then cache=$HOME/.ccache; fi
mkdir -p "$cache" 2>/dev/null && [[ -w $cache ]] || export CCACHE_DISABLE=1

log=build/$preset-configure.log
mkdir -p build
if ! cmake --preset "$preset" "${options[@]}" >"$log" 2>&1; then
  cat "$log" >&2
  echo "build.sh: the configuration failed; does deploy/install.sh --list name missing packages?" >&2
  exit 1
fi
args=(--build --preset "$preset" --parallel "$(nproc)")
[[ ${#targets[@]} -eq 0 ]] || args+=(--target "${targets[@]}")
cmake "${args[@]}"
