#!/usr/bin/env bash
# Installs what is missing, builds, runs every test, prints a summary. Not 0 when anything fails.
#
#   deploy/test.sh [--quick] [--preset NAME] ...     options as of deploy/check.sh; default: everything, release
set -euo pipefail
cd "$(dirname "$0")/.."

echo "== packages"
deploy/install.sh --test --package
exec deploy/check.sh --precompiled "$@"
