#!/usr/bin/env bash
# Installs the Debian packages of deploy/packages.txt that are missing. Asks nothing, changes nothing when all are there.
#
#   deploy/install.sh [--test] [--page] [--package] [--dev] [--list]
#     --test     also what only the tests need (Prometheus)
#     --page     also what the operator's page is built with (node, npm), where no node and npm are on the path
#     --package  also what only deploy/package.sh and its check need (lintian)
#     --dev      also the packages only developers need (clang-tidy), and all of the above
#     --list     only print what is missing
set -euo pipefail
cd "$(dirname "$0")/.."

groups=build
list=false
for arg in "$@"; do
  case $arg in
    --test) groups+=" test" ;;
    --page) groups+=" page" ;;
    --package) groups+=" package" ;;
    --dev) groups="build test page package dev" ;;
    --list) list=true ;;
    *) sed -n '2,10s/^# \{0,1\}//p' "$0" >&2; exit 2 ;;
  esac
done

fail() { echo "install.sh: $*" >&2; exit 1; }
command -v dpkg-query >/dev/null && command -v apt-get >/dev/null ||
  fail "this is no Debian (no dpkg/apt-get). Install what deploy/packages.txt names by other means."

# Others' packages of node bring npm along and do not stand beside Debian's.
if command -v node >/dev/null && command -v npm >/dev/null; then groups=${groups// page/}; fi

missing=()
while read -r package group _; do
  [[ -z $package || $package == \#* ]] && continue
  [[ " $groups " == *" $group "* ]] || continue
  state=$(dpkg-query -W -f='${db:Status-Abbrev}' "$package" 2>/dev/null || true)
  [[ $state == ?i* ]] || missing+=("$package")
done < deploy/packages.txt

if [[ ${#missing[@]} -eq 0 ]]; then
  echo "All packages are installed."
  exit 0
fi
if $list; then
  printf '%s\n' "${missing[@]}"
  exit 0
fi

if [[ $(id -u) -eq 0 ]]; then
  as_root=(env)
elif command -v sudo >/dev/null; then
  as_root=(sudo --preserve-env=http_proxy,https_proxy,no_proxy env)
else
  fail "${#missing[@]} packages are missing and you are neither root nor is there sudo. As root, run:
  apt-get install --no-install-recommends ${missing[*]}"
fi

echo "Installing ${#missing[@]} packages: ${missing[*]}"
apt=("${as_root[@]}" DEBIAN_FRONTEND=noninteractive apt-get -q -o DPkg::Lock::Timeout=300)
"${apt[@]}" update || fail "apt-get update failed: is there a network and a package mirror? Behind a proxy, apt takes it from
  http_proxy in the environment or from Acquire::http::Proxy in /etc/apt/apt.conf.d."
"${apt[@]}" install -y --no-install-recommends "${missing[@]}" ||
  fail "apt-get install failed. Horopter is built on Debian 12 (bookworm); other releases may lack packages."
