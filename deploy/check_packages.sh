#!/usr/bin/env bash
# Checks the Debian packages in a throw-away copy of this system (an overlay, without network): they install and
# are removed without a trace, the programs, the C++ and the Python package work from there, the systemd unit is
# valid, and the second stage of the Containerfile ends in a server that answers. Nothing of it stays. Needs root.
#
#   deploy/check_packages.sh [FOLDER]   folder of the packages (default: build/packages, see package.sh)
set -euo pipefail
cd "$(dirname "$0")/.."

[[ $# -le 1 && ${1:-} != -* ]] || { sed -n '2,6s/^# \{0,1\}//p' "$0" >&2; exit 2; }
packages=$(realpath "${1:-build/packages}")
source=$PWD
[[ $(id -u) -eq 0 ]] || { echo "check_packages.sh: needs root, to make a copy of the system" >&2; exit 1; }
ls "$packages"/horopter-server_*.deb "$packages"/horopter-client_*.deb "$packages"/horopter-dev_*.deb \
  "$packages"/python3-horopter_*.deb >/dev/null

if [[ ${HOROPTER_INSIDE:-} != yes ]]; then
  # Namespaces of its own: mounts and network end with it.
  HOROPTER_INSIDE=yes exec unshare --mount --net --pid --fork "$0" "$packages"
fi

copy=$(mktemp -d)
mount -t tmpfs tmpfs "$copy"
mkdir "$copy"/{upper,work,root}
mount -t overlay overlay -o "lowerdir=/,upperdir=$copy/upper,workdir=$copy/work" "$copy/root"
root=$copy/root
mount --rbind /dev "$root/dev"
mount -t proc proc "$root/proc"
ip link set lo up 2>/dev/null || true
inside() { chroot "$root" env DEBIAN_FRONTEND=noninteractive LC_ALL=C.UTF-8 "$@"; }
step() { printf '== %s\n' "$*"; }

step "install"
rm -rf "$root/packages"
mkdir -p "$root/packages"
cp "$packages"/*.deb "$root/packages"
# The text of the Containerfile's last RUN, but for the network and for the packages' names.
containerfile=$(sed -n '/^RUN apt-get/,/[^\\]$/p' deploy/Containerfile | sed 's/^RUN //; s/\\$//' | tr '\n' ' ')
[[ $containerfile == *useradd* ]] || { echo "check_packages.sh: the Containerfile has changed its shape" >&2; exit 1; }
containerfile=${containerfile//apt-get update &&/}
containerfile=${containerfile//\/packages\/horopter-\*.deb/\/packages\/*.deb}
containerfile=${containerfile//rm -rf \/packages \/var\/lib\/apt\/lists\/\* &&/}
inside bash -euc "$containerfile" >"$copy/log" 2>&1 || { cat "$copy/log"; exit 1; }
inside dpkg -s horopter-server horopter-client horopter-dev python3-horopter | grep -c '^Status: install ok installed' | grep -qx 4

step "systemd unit"
inside systemd-analyze verify /lib/systemd/system/horopterd.service

step "manual pages and completion"
inside man --warnings -E UTF-8 -l /usr/share/man/man1/horopter.1 | grep -q 'horopter explain'
inside man --warnings -E UTF-8 -l /usr/share/man/man8/horopterd.8 | grep -q -- '--listen'
inside bash -c '. /usr/share/bash-completion/completions/horopter && complete -p horopter' >/dev/null

step "server of the Containerfile"
user=$(sed -n 's/^USER //p' deploy/Containerfile)
entrypoint=$(sed -n 's/^ENTRYPOINT \["\(.*\)"\]$/\1/p' deploy/Containerfile)
mapfile -t command < <(sed -n 's/^CMD //p' deploy/Containerfile | python3 -c 'import json, sys; print("\n".join(json.load(sys.stdin)))')
chroot --userspec="$user" "$root" "$entrypoint" "${command[@]}" >"$copy/server.log" 2>&1 &
server=$!
for _ in $(seq 300); do
  grep -q 'listening on' "$copy/server.log" && break
  kill -0 "$server" 2>/dev/null || { cat "$copy/server.log"; exit 1; }
  sleep 0.1
done
cp -r "$source/tests/data/parts/cad/obj_000001.step" "$source/tests/data/parts/val/000005/rgb/000000.png" \
  "$source/client/example" "$root/packages/"
inside horopter status
inside horopter object add /packages/obj_000001.step --id bracket
inside horopter recognize /packages/000000.png --out /packages/overlay.png >/dev/null
[[ -s $root/packages/overlay.png ]]
inside /usr/bin/python3 -B -c 'import horopter
with horopter.Client("localhost:50051") as client: assert [o.object_id for o in client.list_objects()] == ["bracket"]'
python3 - <<'METRICS'
import urllib.request
assert b"horopter_build_info" in urllib.request.urlopen("http://127.0.0.1:9464/metrics", timeout=10).read()
METRICS

step "a C++ program by find_package"
inside cmake -G Ninja -S /packages/example -B /packages/example-build >"$copy/log" 2>&1 &&
  inside cmake --build /packages/example-build >>"$copy/log" 2>&1 || { cat "$copy/log"; exit 1; }
inside /packages/example-build/pick localhost:50051 /packages/000000.png >/dev/null

kill -TERM "$server"
wait "$server"
[[ -s $root/var/lib/horopter/parts.db ]]

step "remove"
inside apt-get purge -y horopter-server horopter-client horopter-dev python3-horopter >"$copy/log" 2>&1 || { cat "$copy/log"; exit 1; }
left=$(cd "$copy/upper" && find . \( -name '*horopter*' -o -path './etc/horopter*' \) -not -path './tmp/*' -not -path './packages/*' -not -path './var/*' \
  -not -path './home/*' -type f -print)
[[ -z $left ]] || { echo "left behind: $left" >&2; exit 1; }
echo "The packages are good."
