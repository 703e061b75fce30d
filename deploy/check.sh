#!/usr/bin/env bash
# What CI runs, without installing anything: format, layers, build, tests, summary. Not 0 when any of it fails.
#
#   deploy/check.sh [--static] [--quick] [--preset NAME] [--precompiled]
#     --static        only the checks that need no build (format, layers)
#     --quick         leave out the tests labelled "slow"
#     --preset NAME   build and test this preset (default: release; dev has the sanitizers)
#     --precompiled   build with precompiled headers: a quarter sooner where no compiler cache helps
#                     Files are compiled one by one, as who changes some of them wants it.
set -euo pipefail
cd "$(dirname "$0")/.."

static=false
preset=release
selection=()
building=()
while [[ $# -gt 0 ]]; do
  case $1 in
    --static) static=true; shift ;;
    --quick) selection=(-LE '^slow$'); shift ;;
    --preset) preset=${2:?--preset needs a name}; shift 2 ;;
    --precompiled) building=(--precompiled); shift ;;
    *) sed -n '2,9s/^# \{0,1\}//p' "$0" >&2; exit 2 ;;
  esac
done

failed=()
step() { echo; echo "== $*"; }

step "format"
mapfile -d '' sources < <(find server db client console proto tests -name build -prune -o \
  -type f \( -name '*.cc' -o -name '*.h' \) -print0 | sort -z)
if clang-format --dry-run -Werror "${sources[@]}"; then
  echo "${#sources[@]} files, all formatted"
else
  failed+=(format)
  echo "Run: clang-format -i FILE..."
fi

step "layers"
python3 -B tests/layering/layering.py . || failed+=(layers)

if ! $static; then
  step "build ($preset)"
  start=$SECONDS
  if deploy/build.sh --preset "$preset" --single "${building[@]}"; then
    echo "built in $((SECONDS - start)) s"
    step "tests ($preset)"
    results=$PWD/build/$preset/test-results.xml
    rm -f "$results"
    start=$SECONDS
    ctest --preset "$preset" --parallel "$(nproc)" --output-junit "$results" "${selection[@]}" || failed+=(tests)
    echo "tested in $((SECONDS - start)) s"
    step "summary"
    python3 -B deploy/summary.py "$results" || failed+=(summary)
  else
    failed+=(build)
  fi
fi

if [[ ${#failed[@]} -gt 0 ]]; then
  echo "FAILED: ${failed[*]}"
  exit 1
fi
echo "All checks passed."
