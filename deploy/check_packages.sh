#!/usr/bin/env bash
# Checks the packages of deploy/package.sh in a throw-away copy of this system (an overlay, without network, with a systemd of its own):
# what Debian asks of them (lintian), what is in them, that apt takes them from their folder, an upgrade from an older version, the
# installed unit with and without TLS, recognition, the wheel, C++ and Python programs, the demonstration, the container's recipe, and
# that they go without a trace. Nothing of it stays. Needs root.
#
#   deploy/check_packages.sh [FOLDER]   folder of the packages (default: build/packages, see package.sh)
set -euo pipefail
cd "$(dirname "$0")/.."

[[ $# -le 1 && ${1:-} != -* ]] || { sed -n '2,7s/^# \{0,1\}//p' "$0" >&2; exit 2; }
packages=$(realpath "${1:-build/packages}")
[[ $(id -u) -eq 0 ]] || { echo "check_packages.sh: needs root, to make a copy of the system" >&2; exit 1; }
compgen -G "$packages/horopter-server_*.deb" >/dev/null || { echo "check_packages.sh: no packages in $packages" >&2; exit 1; }
step() { printf '== %s\n' "$*"; }

if [[ ${HOROPTER_INSIDE:-} != yes ]]; then
  step "checksums"
  (cd "$packages" && sha256sum --check --quiet SHA256SUMS)
  step "lintian"
  # Of the archive's own customs, not of packages.
  lintian --no-cfg --fail-on error --suppress-tags bogus-mail-host,bogus-mail-host-in-debian-changelog --allow-root "$packages"/*.deb
  step "contents"
  python3 -B deploy/check_contents.py "$packages"
  # Namespaces of its own: mounts, network and processes end with it.
  HOROPTER_INSIDE=yes exec unshare --mount --net --pid --ipc --uts --cgroup --fork "$0" "$packages"
fi

copy=$(mktemp -d)
mount -t tmpfs tmpfs "$copy"
mkdir "$copy"/{upper,work,root}
mount -t overlay overlay -o "lowerdir=/,upperdir=$copy/upper,workdir=$copy/work" "$copy/root"
root=$copy/root
# A mount of its own, for pivot_root below.
mount --bind "$root" "$root"
mkdir -p "$root/check" "$root/upper" "$root/old"
cp "$packages"/* "$root/check"
cp -r tests/data/parts/cad/obj_000001.step tests/data/parts/val/000005/rgb/000000.png client/example deploy/Containerfile \
  deploy/check_installed.sh "$root/check"
mount --bind "$copy/upper" "$root/upper"
mount -t proc proc "$root/proc"
mount -t sysfs sysfs "$root/sys"
mount -t tmpfs tmpfs "$root/run"
mount -t tmpfs tmpfs "$root/tmp"
chmod 1777 "$root/tmp"
mount -t tmpfs tmpfs "$root/sys/fs/cgroup"
mkdir "$root/sys/fs/cgroup/systemd"
mount -t cgroup -o none,name=systemd cgroup "$root/sys/fs/cgroup/systemd" 2>/dev/null || {
  umount "$root/sys/fs/cgroup"
  mount -t cgroup2 cgroup2 "$root/sys/fs/cgroup"
}
mkdir "$copy/dev"
mount -t tmpfs tmpfs "$copy/dev"
for device in null zero full random urandom tty; do
  touch "$copy/dev/$device"
  mount --bind "/dev/$device" "$copy/dev/$device"
done
mkdir "$copy/dev/shm" "$copy/dev/pts"
ln -s /proc/self/fd "$copy/dev/fd"
ln -s pts/ptmx "$copy/dev/ptmx"  # what PrivateDevices= makes a copy of
mount --rbind "$copy/dev" "$root/dev"
ip link set lo up
: >"$root/etc/machine-id"
cat >"$root/etc/systemd/system/check.target" <<'UNIT'
[Unit]
DefaultDependencies=no
Requires=check.service
UNIT
cat >"$root/etc/systemd/system/check.service" <<'UNIT'
[Unit]
DefaultDependencies=no
SuccessAction=exit-force
FailureAction=exit-force
[Service]
Type=oneshot
TimeoutStartSec=1200
ExecStart=/check/check_installed.sh
StandardOutput=file:/check/log
StandardError=file:/check/log
UNIT
touch "$root/check/log"
tail -n +1 -f "$root/check/log" &
reader=$!
# systemd wants to be the first process in a root of its own.
set +e
(
  cd "$root" && mount --make-rprivate / && pivot_root . old && cd / && umount -l /old && mount --make-rshared / &&
    exec env -i container=check PATH=/usr/sbin:/usr/bin:/sbin:/bin \
      unshare --pid --fork --mount-proc --propagation shared /lib/systemd/systemd --system --unit=check.target --log-target=null --show-status=no
)
status=$?
# What it said last is to be read, too.
sleep 2
kill "$reader" 2>/dev/null
exit "$status"
