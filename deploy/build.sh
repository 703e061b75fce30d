#!/usr/bin/env bash
# Configures a preset and builds it.
#
#   deploy/build.sh [--preset NAME] [--batches | --single] [--precompiled] [--jobs N] [TARGET...]
#     --preset NAME   a configure preset of CMakePresets.json (default: release)
#     --batches       several files of a target are compiled as one (docs/building.md): the soonest first build, and the default where
#                     nothing has been configured yet
#     --single        each file is compiled alone: the soonest second build
#     --precompiled   with precompiled headers where files are compiled alone
#     --jobs N        compilations at a time (default: a core and 2 GB of free memory for each)
#     TARGET          what to build (default: everything)
set -euo pipefail
cd "$(dirname "$0")/.."

preset=release
targets=()
options=()
jobs=
while [[ $# -gt 0 ]]; do
  case $1 in
    --preset) preset=${2:?--preset needs a name}; shift 2 ;;
    --batches) options+=(-DHOROPTER_UNITY=ON); shift ;;
    --single) options+=(-DHOROPTER_UNITY=OFF); shift ;;
    --jobs) jobs=${2:?--jobs needs a number}; shift 2 ;;
    --precompiled) options+=(-DHOROPTER_PRECOMPILED_HEADERS=ON); shift ;;
    -*) sed -n '2,12s/^# \{0,1\}//p' "$0" >&2; exit 2 ;;
    *) targets+=("$1"); shift ;;
  esac
done

# A compiler cache in a home folder that cannot be written would end every compilation.
cache=${CCACHE_DIR:-${XDG_CACHE_HOME:-${HOME:-/nonexistent}/.cache}/ccache}
if [[ -z ${CCACHE_DIR:-} && -d ${HOME:-/nonexistent}/.ccache ]]; then cache=$HOME/.ccache; fi
mkdir -p "$cache" 2>/dev/null && [[ -w $cache ]] || export CCACHE_DISABLE=1

# With more compilations than memory allows the system kills one of them, or swaps.
per_job_mb=2000
free_mb=$(awk '/^MemAvailable:/ { print int($2 / 1024) }' "${HOROPTER_MEMINFO:-/proc/meminfo}")
for group in /sys/fs/cgroup/memory /sys/fs/cgroup; do  # of a container: what it may take and has taken
  limit=$(cat "$group/memory.max" "$group/memory.limit_in_bytes" 2>/dev/null | head -n 1 || true)
  used=$(cat "$group/memory.current" "$group/memory.usage_in_bytes" 2>/dev/null | head -n 1 || true)
  [[ $limit =~ ^[0-9]{1,15}$ && $used =~ ^[0-9]+$ ]] || continue
  left=$(((limit - used) / 1048576))
  [[ $left -ge $free_mb ]] || free_mb=$left
done
if [[ -z $jobs ]]; then
  cores=$(nproc)
  jobs=$((free_mb / per_job_mb))
  [[ $jobs -le $cores ]] || jobs=$cores
  if [[ $jobs -lt 1 ]]; then
    jobs=1
    echo "build.sh: a compilation takes up to $per_job_mb MB of memory and only $free_mb MB are free: it may be killed." >&2
  fi
  echo "build.sh: $jobs at a time ($cores cores, $free_mb MB free, up to $per_job_mb MB each)"
elif [[ ! $jobs =~ ^[1-9][0-9]{0,3}$ ]]; then
  echo "build.sh: --jobs $jobs: need a number from 1 on" >&2
  exit 2
fi

# A folder that is there keeps what it was made with: somebody works in it. The sanitizers' presets are of who develops.
if [[ ${#options[@]} -eq 0 && $preset == release && ! -e build/$preset/CMakeCache.txt ]]; then options=(-DHOROPTER_UNITY=ON); fi
log=build/$preset-configure.log
mkdir -p build
if ! cmake --preset "$preset" "${options[@]}" >"$log" 2>&1; then
  cat "$log" >&2
  echo "build.sh: the configuration failed; does deploy/install.sh --list name missing packages?" >&2
  exit 1
fi
args=(--build --preset "$preset" --parallel "$jobs")
[[ ${#targets[@]} -eq 0 ]] || args+=(--target "${targets[@]}")
cmake "${args[@]}"
