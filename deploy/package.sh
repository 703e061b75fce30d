#!/usr/bin/env bash
# Makes Debian packages of what is built: horopter-server, horopter-client, horopter-dev, python3-horopter in build/packages.
#
#   deploy/package.sh [--preset NAME]
#     --preset NAME   package this preset's build (default: release)
set -euo pipefail
cd "$(dirname "$0")/.."

preset=release
while [[ $# -gt 0 ]]; do
  case $1 in
    --preset) preset=${2:?--preset needs a name}; shift 2 ;;
    *) sed -n '2,5s/^# \{0,1\}//p' "$0" >&2; exit 2 ;;
  esac
done

deploy/build.sh --preset "$preset" horopterd horopter horopter_python sample_config >/dev/null
out=$PWD/build/packages
mkdir -p "$out"
rm -f "$out"/*.deb
(cd "build/$preset" && cpack -G DEB -B "$out" >"$out/cpack.log") || { cat "$out/cpack.log" >&2; exit 1; }
rm -rf "$out/_CPack_Packages"
ls "$out"/*.deb
