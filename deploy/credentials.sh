#!/usr/bin/env bash
# Makes what a private server and its clients need: an authority, certificates, tokens and the access file. For a cell of
# its own, the demo and the tests; where there is an authority already, use that.
#
#   deploy/credentials.sh FOLDER [--host NAME]... [--days N] [--install FOLDER [--owner USER]]
#     --host   name or address that clients know the server by (localhost, 127.0.0.1 and this machine's name are always in)
#     --days   how long the certificates are good (default 825; the authority twice as long)
#     --install   copies what the server needs to FOLDER/keys (server.pem, server.key, ca.pem) and FOLDER/access, e.g. /etc/horopter
#     --owner     whom the copies belong to (default: who calls; a container's server is 10001)
#
#   ca.pem ca.key              the authority; ca.key can make any certificate: keep it off the server and the robots
#   server.pem server.key      horopterd --tls-cert --tls-key
#   robot.pem .key, and alike for teacher, observer and admin   client certificates (common names as the files), with horopterd
#                              --tls-client-ca ca.pem
#   robot.token teacher.token observer.token admin.token    horopter --token-file; a robot recognises, a teacher's requests teach
#                              stations as well, an observer sees what others are answered
#   access                     horopterd --access-file: the tokens' hashes and the certificates, with their roles
#
# Never replaces a file: run again in the same folder with the authority there, it makes what is missing.
set -euo pipefail
umask 077

folder=
hosts=()
days=825
install=
owner=
while [[ $# -gt 0 ]]; do
  case $1 in
    --host) hosts+=("${2:?--host needs a name}"); shift 2 ;;
    --days) days=${2:?--days needs a number}; shift 2 ;;
    --install) install=$(realpath -m "${2:?--install needs a folder}"); shift 2 ;;
    --owner) owner=${2:?--owner needs a user}; shift 2 ;;
    -*) folder=; break ;;
    *) folder=$1; shift ;;
  esac
done
if [[ -z $folder ]]; then
  sed -n '2,10s/^# \{0,1\}//p' "$0" >&2
  exit 2
fi
mkdir -p "$folder"
cd "$folder"

new_key() { openssl genpkey -quiet -algorithm EC -pkeyopt ec_paramgen_curve:P-256 -out "$1" 2>/dev/null ||
  openssl genpkey -algorithm EC -pkeyopt ec_paramgen_curve:P-256 -out "$1" 2>/dev/null; }

if [[ ! -e ca.pem ]]; then
  new_key ca.key
  openssl req -x509 -new -key ca.key -subj "/CN=horopter authority" -days $((days < 0 ? 1 : 2 * days)) \
    -addext "keyUsage=critical,keyCertSign,cRLSign" -out ca.pem
fi

# NAME PURPOSE EXTENSIONS: a key and a certificate of the authority.
certificate() {
  [[ -e $1.pem ]] && return
  new_key "$1.key"
  openssl req -new -key "$1.key" -subj "/CN=$1" |
    openssl x509 -req -CA ca.pem -CAkey ca.key -days "$days" -out "$1.pem" -extfile <(
      printf 'basicConstraints=CA:FALSE\nkeyUsage=digitalSignature\nextendedKeyUsage=%s\n%s' "$2" "${3:-}") 2>/dev/null
}

names=DNS:localhost,IP:127.0.0.1,IP:::1,DNS:$(hostname)
for host in "${hosts[@]}"; do
  [[ $host =~ ^[0-9.]+$|: ]] && names+=,IP:$host || names+=,DNS:$host
done
certificate server serverAuth "subjectAltName=$names"
for role in robot teacher observer admin; do
  certificate $role clientAuth
done

for role in robot teacher observer admin; do
  [[ -e $role.token ]] || openssl rand -hex 32 >"$role.token"
done
if [[ ! -e access ]]; then
  {
    echo "# ROLE  NAME  sha256:HEX [until=YYYY-MM-DD]  or  cert:COMMON_NAME"
    for role in robot teacher observer admin; do
      printf '%s %s sha256:%s\n' "$role" "$role" "$(head -c -1 "$role.token" | sha256sum | cut -d' ' -f1)"
      printf '%s %s-certificate cert:%s\n' "$role" "$role" "$role"
    done
  } >access
fi

# The key is the server's alone. The access file holds hashes of long random tokens: anybody may read it, so that the server can,
# whoever it is, and what is changed there is in force within a second.
if [[ -n $install ]]; then
  install -d -m 755 "$install"
  install -d -m 700 ${owner:+-o "$owner"} "$install/keys"
  install -m 600 ${owner:+-o "$owner"} server.pem server.key ca.pem "$install/keys"
  install -m 644 access "$install/access"
fi
