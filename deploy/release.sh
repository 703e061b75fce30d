#!/usr/bin/env bash
# Makes a release of this commit: packages, wheel, bill of materials, source archive, notes (the version's section of CHANGELOG.md) and
# checksums in build/release-VERSION; with --tag the tag vVERSION, which nobody pushes. The same commit makes the same bytes.
#
#   deploy/release.sh [--tag] [--check]
#     --tag     sign off: the annotated tag; refused when it is there already at another commit
#     --check   makes it twice and compares
set -euo pipefail
cd "$(dirname "$0")/.."

tag=false
check=false
for arg in "$@"; do
  case $arg in
    --tag) tag=true ;;
    --check) check=true ;;
    *) sed -n '2,7s/^# \{0,1\}//p' "$0" >&2; exit 2 ;;
  esac
done
fail() { echo "release.sh: $*" >&2; exit 1; }
[[ -z $(git status --porcelain) ]] || fail "there are changes that are not committed; a release is a commit"
number=$(sed -n 's/^project(horopter VERSION \([0-9.]*\).*/\1/p' CMakeLists.txt)
prerelease=$(sed -n 's/^set(HOROPTER_PRERELEASE "\(.*\)")/\1/p' CMakeLists.txt)
version=$number${prerelease:+-$prerelease}
notes=$(python3 -B deploy/debian_changelog.py --section CHANGELOG.md "$version")
grep -q "^## \[\?$version" CHANGELOG.md || fail "CHANGELOG.md has no section $version"
if $tag && git rev-parse -q --verify "refs/tags/v$version" >/dev/null; then
  [[ $(git rev-parse "v$version^{commit}") == $(git rev-parse HEAD) ]] || fail "v$version is another commit"
fi
SOURCE_DATE_EPOCH=$(git log -1 --format=%ct)
export SOURCE_DATE_EPOCH

make_release() {  # FOLDER
  rm -rf "$1"
  mkdir -p "$1"
  deploy/package.sh --out "$1" >/dev/null
  git archive --format=tar --prefix="horopter-$version/" HEAD | xz -9 --threads=1 >"$1/horopter-$version.tar.xz"
  printf '%s\n' "$notes" >"$1/horopter-$version.md"
  (cd "$1" && sha256sum -- "horopter-$version.tar.xz" "horopter-$version.md" >>SHA256SUMS)
}

out=$PWD/build/release-$version
make_release "$out"
if $check; then
  make_release "$out-again"
  diff -r "$out" "$out-again" || fail "the same sources made other bytes"
  rm -rf "$out-again"
  echo "Twice the same bytes."
fi
if $tag && ! git rev-parse -q --verify "refs/tags/v$version" >/dev/null; then
  git tag -a "v$version" -m "Horopter $version"
fi
(cd "$out" && sha256sum --quiet --check SHA256SUMS)
echo "$out"
