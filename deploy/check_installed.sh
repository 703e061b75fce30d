#!/usr/bin/env bash
# The part of check_packages.sh that runs inside the copy of the system, where systemd runs and the packages lie beside this script.
set -euo pipefail
# Elsewhere it would replace what is installed.
[[ $(cat /run/systemd/container 2>/dev/null) == check ]] || { echo "check_installed.sh: is run by check_packages.sh, in a copy of the system" >&2; exit 2; }
here=$(cd "$(dirname "$0")" && pwd)
keys=$here/keys
mkdir -p "$here/home"
export DEBIAN_FRONTEND=noninteractive LC_ALL=C.UTF-8 HOME=$here/home PYTHONDONTWRITEBYTECODE=1
cd "$here"
step() { printf '== %s\n' "$*"; }
fail() { echo "FAILED: $*"; exit 1; }
trap 'echo "check_installed.sh: line $LINENO failed"; systemctl status --no-pager --lines 0 horopterd 2>&1 | head -20; tail -n 40 "$here/server.log" 2>/dev/null' ERR
quietly() { "$@" >"$here/output" 2>&1 || { cat "$here/output"; return 1; }; }
until_it_listens() {  # PID LOG
  for _ in $(seq 600); do
    ! grep -q 'listening on' "$2" || return 0
    kill -0 "$1" 2>/dev/null || break
    sleep 0.1
  done
  cat "$2"
  return 1
}
# Journald is not running here.
mkdir -p /etc/systemd/system/horopterd.service.d
printf '[Service]\nStandardOutput=append:%s\nStandardError=append:%s\n' "$here/server.log" "$here/server.log" >/etc/systemd/system/horopterd.service.d/log.conf
server_package=$(ls horopter-server_*.deb)

step "apt takes the folder as a source"
mkdir -p /etc/apt/check.d
echo "deb [trusted=yes] file:$here ./" >/etc/apt/check.d/horopter.list
apt=(apt-get -y -o Dir::Etc::sourcelist=/dev/null -o Dir::Etc::sourceparts=/etc/apt/check.d -o APT::Sandbox::User=root
  -o Dpkg::Options::=--force-confold --no-install-recommends)
quietly "${apt[@]}" update

step "an older version, changed by its user, is upgraded"
# As version 0.1.0 was: documents elsewhere, a configuration with other defaults and a unit of another type.
dpkg-deb -R "$server_package" old
sed -i 's/^Version:.*/Version: 0.1.0/' old/DEBIAN/control
rm old/DEBIAN/p* old/DEBIAN/md5sums
rm -r old/usr/share/horopter old/etc/logrotate.d
printf '/etc/horopter/horopterd.toml\n' >old/DEBIAN/conffiles
mkdir -p old/usr/share/doc/horopter
echo old >old/usr/share/doc/horopter/credentials.sh
printf 'admin-calls=false\ncores=2\nlisten="localhost:50051"\ndb=""\n' >old/etc/horopter/horopterd.toml
quietly dpkg-deb --root-owner-group -b old old.pkg
quietly dpkg -i old.pkg
printf 'listen="localhost:50077"\ndb="/var/lib/horopter/mine.db"\n' >/etc/horopter/horopterd.toml
quietly "${apt[@]}" install horopter-server horopter-client horopter-dev horopter-demo horopter-console python3-horopter
[[ $(dpkg -s horopter-server horopter-client horopter-dev horopter-demo horopter-console python3-horopter | grep -c '^Status: install ok installed') -eq 6 ]]
grep -q mine.db /etc/horopter/horopterd.toml || fail "the user's configuration is gone"
[[ -e /etc/horopter/horopterd.toml.dpkg-dist && ! -e /usr/share/doc/horopter/credentials.sh ]]
systemctl start horopterd
horopter --server localhost:50077 status >/dev/null
systemctl stop horopterd
[[ -s /var/lib/horopter/mine.db ]]
mv /etc/horopter/horopterd.toml.dpkg-dist /etc/horopter/horopterd.toml
rm /var/lib/horopter/mine.db*

step "the unit, its manual pages and completion"
systemd-analyze verify /lib/systemd/system/horopterd.service
man --warnings -E UTF-8 -l /usr/share/man/man1/horopter.1.gz | grep -q 'horopter explain'
man --warnings -E UTF-8 -l /usr/share/man/man8/horopterd.8.gz | grep -q -- '--listen'
bash -c '. /usr/share/bash-completion/completions/horopter && complete -p horopter' >/dev/null

step "the configuration as it is installed"
systemctl start horopterd  # returns when the server says that it is ready
[[ $(stat -c %u "/proc/$(systemctl show -P MainPID horopterd)") -ne 0 && $(systemctl show -P NRestarts horopterd) == 0 ]]
limit=$(sed -n 's/^Max open files *\([0-9]*\).*/\1/p' "/proc/$(systemctl show -P MainPID horopterd)/limits")
allowed=$(ulimit -Hn)  # of who made the copy: a machine may not give more
[[ $allowed != unlimited && $allowed -lt 65536 ]] || allowed=65536
[[ $limit -ge $allowed ]] || fail "$limit open files"
horopter object add obj_000001.step --id bracket >/dev/null
horopter recognize 000000.png --out overlay.png >answer.txt
[[ -s overlay.png ]]
[[ -s /var/lib/horopter/parts.db ]] || fail "the catalog is not in the state directory"

step "SIGHUP and an upgrade keep it running"
pid=$(systemctl show -P MainPID horopterd)
systemctl reload horopterd
horopter status >/dev/null
[[ $(systemctl show -P MainPID horopterd) == "$pid" ]]
quietly dpkg -i "$server_package"
horopter status >/dev/null
[[ $(systemctl show -P MainPID horopterd) != "$pid" ]] || fail "an upgrade does not start the server anew"
horopter object list | grep -q bracket || fail "the catalog is gone"

step "the operator's page"
systemd-analyze verify /lib/systemd/system/horopter-console.service
systemctl start horopter-console
[[ $(stat -c %u "/proc/$(systemctl show -P MainPID horopter-console)") -ne 0 ]]
/usr/bin/python3 - <<'PYTHON'
import json
import urllib.request
def ask(path, body=None):
    asked = urllib.request.Request("http://127.0.0.1:8080" + path, body, {"X-Horopter-Console": "1"})
    with urllib.request.urlopen(asked, timeout=30) as answer:
        return answer.read()
assert b"<html" in ask("/")
assert json.loads(ask("/healthz"))["serving"]
assert json.loads(ask("/sign-in", b'{"token": ""}'))["signed_in"]
PYTHON
systemctl reload horopter-console
systemctl stop horopter-console

step "Python: the package, and the wheel in an environment of its own"
cat >ask.py <<'PYTHON'
import horopter
with horopter.Client("localhost:50051") as client:
    assert [o.object_id for o in client.list_objects()] == ["bracket"]
PYTHON
/usr/bin/python3 ask.py
# A CAD file that the server reads, under the unit's restrictions.
/usr/bin/python3 - <<'PYTHON'
import horopter
with horopter.Client("localhost:50051") as client:
    made = client.import_object("by-python", "obj_000001.step")
    assert made.object.ready and made.object.edge_count == client.get_object("bracket").edge_count, made
    client.delete_object("by-python")
PYTHON
quietly /usr/bin/python3 -m venv --system-site-packages --without-pip venv
quietly /usr/bin/python3 -m pip --python venv/bin/python3 install --no-index --no-deps --ignore-installed ./*.whl ||
  /usr/bin/python3 -m zipfile -e ./*.whl venv/lib/python3*/site-packages/
venv/bin/python3 -c 'import horopter; assert "/venv/" in horopter.__file__, horopter.__file__'
venv/bin/python3 ask.py

step "a C++ program by find_package"
quietly cmake -G Ninja -S example -B example-build
quietly cmake --build example-build
example-build/pick localhost:50051 000000.png >/dev/null

step "with TLS, keys of root, tokens and an audit log, on all addresses"
systemctl stop horopterd
/usr/share/horopter/deploy/credentials.sh "$keys" --install /etc/horopter 2>/dev/null
[[ $(stat -c %a /etc/horopter/keys/server.key) == 600 ]]
credentials=/run/credentials/horopterd.service
sed -i -e 's|^listen=.*|listen="0.0.0.0:50051"|' -e "s|^tls-cert=.*|tls-cert=\"$credentials/keys_server.pem\"|" \
  -e "s|^tls-key=.*|tls-key=\"$credentials/keys_server.key\"|" -e 's|^access-file=.*|access-file="/etc/horopter/access"|' \
  -e 's|^audit-log=.*|audit-log="/var/log/horopter/audit.jsonl"|' -e 's|^audit-required=.*|audit-required=true|' \
  /etc/horopter/horopterd.toml
systemctl start horopterd
! horopter --timeout 3 status >/dev/null 2>&1 || fail "it answers in the clear"
export HOROPTER_TLS_CA=$keys/ca.pem
! horopter object list >/dev/null 2>&1 || fail "it answers without a token"
! HOROPTER_TOKEN_FILE=$keys/robot.token horopter object delete bracket >/dev/null 2>&1 || fail "a robot may delete"
HOROPTER_TOKEN_FILE=$keys/robot.token horopter recognize 000000.png >/dev/null
HOROPTER_TOKEN_FILE=$keys/admin.token horopter object add obj_000001.step --id second >/dev/null
grep -q '"caller":"admin"' /var/log/horopter/audit.jsonl
sed -i '/sha256:/d' /etc/horopter/access
systemctl reload horopterd
! HOROPTER_TOKEN_FILE=$keys/admin.token horopter object list >/dev/null 2>&1 || fail "a token is good that was taken away"
if command -v logrotate >/dev/null; then
  logrotate --force --state "$here/logrotate" /etc/logrotate.d/horopter-server
  ! HOROPTER_TOKEN_FILE=$keys/robot.token horopter object delete bracket >/dev/null 2>&1
  [[ -s /var/log/horopter/audit.jsonl && -s /var/log/horopter/audit.jsonl.1 ]] || fail "the log is not opened anew"
fi
unset HOROPTER_TLS_CA

step "what must not start does not, and says why"
refused() {  # SED_EXPRESSION WORDS
  systemctl stop horopterd
  cp /etc/horopter/horopterd.toml kept.toml
  sed -i "$1" /etc/horopter/horopterd.toml
  : >server.log
  ! timeout 60 /usr/bin/horopterd --config /etc/horopter/horopterd.toml --db refused.db >refused.log 2>&1 || fail "it starts: $1"
  grep -q -- "$2" refused.log || { cat refused.log; fail "no word of: $2"; }
  cp kept.toml /etc/horopter/horopterd.toml
}
refused 's|^access-file=|access_file=|' "did you mean 'access-file'"
refused 's|^access-file=.*|access-file=""|' 'open-access'
refused 's|^listen=.*|listen="localhost:70000"|' 'port'
refused "s|^tls-key=.*|tls-key=\"$keys/admin.key\"|;s|$credentials/keys_server.pem|$keys/server.pem|" 'is not the key'
/usr/bin/python3 -c 'import socket, time; s = socket.create_server(("127.0.0.1", 50123)); time.sleep(600)' &
holder=$!
sleep 1
refused 's|^listen=.*|listen="127.0.0.1:50123"|;/^tls-/d;/^access-file/d' 'in use'
kill "$holder"

step "the container's recipe"
user=$(sed -n 's/^USER //p' Containerfile)
recipe=$(sed -n '/^RUN /,/[^\\]$/p' Containerfile | sed 's/^RUN //; s/\\$//' | tr '\n' ' ')
making=${recipe##*&& useradd}
[[ $recipe != "$making" ]] || fail "the Containerfile has changed its shape"
bash -euc "useradd $making"
mapfile -t command < <(sed -n 's/^\(ENTRYPOINT\|CMD\) //p' Containerfile | /usr/bin/python3 -c 'import json, sys
for line in sys.stdin: print("\n".join(json.loads(line)))')
health=$(sed -n '/^HEALTHCHECK/,/[^\\]$/p' Containerfile | tr -d '\\\n' | sed 's/.* CMD //')
rm -rf /var/lib/horopter && install -d -o "$user" /var/lib/horopter && mv /etc/horopter /etc/horopter.kept
as_user() { setpriv --reuid="$user" --regid="$user" --clear-groups "$@"; }
become_user() { exec setpriv --reuid="$user" --regid="$user" --clear-groups "$@"; }  # in the background: signals reach it
become_user "${command[@]}" >container.log 2>&1 &
server=$!
until_it_listens "$server" container.log
as_user bash -c "$health"
/usr/bin/python3 -c 'import urllib.request
assert b"horopter_build_info" in urllib.request.urlopen("http://127.0.0.1:9464/metrics", timeout=60).read()'
kill -TERM "$server"
wait "$server"
! as_user bash -c "$health" || fail "a server that is not there is healthy"
/usr/share/horopter/deploy/credentials.sh "$keys" --install "$here/container" --owner "$user"
mv "$here/container" /etc/horopter
become_user /usr/bin/horopterd --listen 0.0.0.0:50051 --tls-cert /etc/horopter/keys/server.pem --tls-key /etc/horopter/keys/server.key \
  --access-file /etc/horopter/access >container.log 2>&1 &
server=$!
until_it_listens "$server" container.log
as_user bash -c "$health"
kill -TERM "$server"
wait "$server"
rm -rf /etc/horopter && mv /etc/horopter.kept /etc/horopter

step "the demonstration, with a home that cannot be written, a proxy that is not there and a blank in the path"
mkdir "$here/a folder"
(cd "$here/a folder" && HOME=/nonexistent http_proxy=http://127.0.0.1:9 https_proxy=http://127.0.0.1:9 \
  setpriv --reuid=nobody --regid=nogroup --clear-groups horopter-demo >"$here/demo.txt" 2>&1) || { cat "$here/demo.txt"; exit 1; }
grep -q 'grasp_[0-9]* at (' "$here/demo.txt" || fail "no grasp"
[[ -s $(sed -n 's/^Overlay: //p' "$here/demo.txt") ]] || fail "no picture"
tail -n 1 "$here/demo.txt"

step "removed, nothing is left but the catalog and the keys"
quietly "${apt[@]}" purge horopter-server horopter-client horopter-dev horopter-demo horopter-console python3-horopter
left=$(cd /upper && find . -name '*horopter*' \( -type f -o -type l \) -not -path ".$here/*" -not -path './var/lib/dpkg/*' -not -path './var/lib/apt/*' \
  -not -path './var/cache/*' -not -path './var/log/*' -not -path './etc/apt/*' -not -path './etc/systemd/*')
[[ -z $left ]] || fail "left behind: $left"
[[ -e /etc/horopter/keys/server.key && ! -e /etc/horopter/horopterd.toml && ! -e /etc/horopter/horopter-console.toml && ! -e /var/log/horopter ]] || { ls -lR /etc/horopter /var/log/horopter; exit 1; }
echo "The packages are good."
