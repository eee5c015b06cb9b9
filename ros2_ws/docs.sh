#!/usr/bin/env bash
# Builds the documentation site into a folder, from nothing, and fails on a warning: docs.sh FOLDER
set -euo pipefail
rm -rf "${1:?usage: docs.sh FOLDER}"
cd "$(dirname "${BASH_SOURCE[0]}")/.."
python -m sphinx --quiet --fail-on-warning --fresh-env --jobs 1 --doctree-dir "$1.doctrees" docs "$1"
rm -rf "$1.doctrees"
