#!/usr/bin/env bash
# Makes packages of what is built: Debian packages (horopter-server, -client, -dev, -demo, -console, python3-horopter), a Python wheel, a bill
# of materials (SPDX) and checksums, in a folder that apt takes as a source. The same sources make the same bytes.
#
#   deploy/package.sh [--preset NAME] [--out FOLDER]
#     --preset NAME   package this preset's build (default: release)
#     --out FOLDER    default: build/packages; files of these kinds in it are replaced
#
# apt: echo "deb [trusted=yes] file:FOLDER ./" >/etc/apt/sources.list.d/horopter.list; the name may hold no blank.
# Dates are those of the sources: SOURCE_DATE_EPOCH, else of the last commit, else of CHANGELOG.md.
set -euo pipefail
cd "$(dirname "$0")/.."
umask 022

preset=release
out=$PWD/build/packages
while [[ $# -gt 0 ]]; do
  case $1 in
    --preset) preset=${2:?--preset needs a name}; shift 2 ;;
    --out) out=$(realpath -m "${2:?--out needs a folder}"); shift 2 ;;
    *) sed -n '2,11s/^# \{0,1\}//p' "$0" >&2; exit 2 ;;
  esac
done
if [[ -z ${SOURCE_DATE_EPOCH:-} ]]; then
  SOURCE_DATE_EPOCH=$(git log -1 --format=%ct 2>/dev/null || stat -c %Y CHANGELOG.md)
fi
export SOURCE_DATE_EPOCH

build=$PWD/build/$preset
# Dates of an earlier commit must not stay in what is only made when its input changes.
rm -f "$build/debian/changelog.gz"
deploy/build.sh --preset "$preset" horopterd horopter horopter_cad_reader horopter_client horopter_python sample_config package_papers >/dev/null
[[ -e $build/console/page/index.html ]] || echo "package.sh: horopter-console is packed WITHOUT its page, which was not built (deploy/install.sh --page; network for npm)" >&2
mkdir -p "$out"
rm -f "$out"/*.deb "$out"/*.whl "$out"/*.spdx.json "$out"/{Packages,Packages.gz,Release,SHA256SUMS}
(cd "$build" && cpack -G DEB -B "$out" >"$out/cpack.log") || { cat "$out/cpack.log" >&2; exit 1; }
rm -rf "$out/_CPack_Packages" "$out/cpack.log"
python3 -B deploy/wheel.py "$build/client/python" "$out"
python3 -B deploy/sbom.py "$out" "$build/console/page/libraries.txt"

cd "$out"
dpkg-scanpackages --multiversion . >Packages 2>/dev/null
gzip -9nk Packages
{
  printf 'Origin: Horopter\nLabel: Horopter\nSuite: stable\nDate: %s\nSHA256:\n' "$(LC_ALL=C date -u -d "@$SOURCE_DATE_EPOCH" -R | sed 's/+0000/UTC/')"
  for file in Packages Packages.gz; do
    printf ' %s %s %s\n' "$(sha256sum <"$file" | cut -d' ' -f1)" "$(stat -c %s "$file")" "$file"
  done
} >Release
sha256sum -- *.deb *.whl *.spdx.json Packages Packages.gz Release >SHA256SUMS
ls -- *.deb *.whl *.spdx.json | sed "s|^|$out/|"
