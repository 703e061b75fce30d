#!/usr/bin/env bash
# A cluster on this machine: PostgreSQL with a standby, three replicas, HAProxy, all on loopback ports and in a temporary
# folder that goes. Runs what docs/cluster.md promises and prints a figure for each. Not 0 when a promise is broken.
#
#   deploy/cluster/test.sh [--quick] [--preset NAME] [CHECK ...]
#     --quick    fewer rounds: for CI
#     CHECK      only these: searchable, rolling, upgrade, queue, poisoned, migrate, partition, gone, eight, nginx, age, prometheus,
#                credentials, clock, tenants, overhead, rankers, restore, burst (1 GB of disk), kills, failover
# Needs what deploy/install.sh --test installs and a build of horopterd and horopter_python. 77 without one of them.
set -euo pipefail
cd "$(dirname "$0")/../.."

preset=release
arguments=()
while [[ $# -gt 0 ]]; do
  case $1 in
    --preset) preset=${2:?--preset needs a name}; shift 2 ;;
    --help) sed -n '2,10s/^# \{0,1\}//p' "$0"; exit 0 ;;
    *) arguments+=("$1"); shift ;;
  esac
done
exec /usr/bin/python3 -B deploy/cluster/cluster_test.py "build/$preset/bin/horopterd" "build/$preset/client/python" "${arguments[@]}"
