#!/usr/bin/env bash
# Builds the documentation site into a folder, from nothing, and fails on a warning: docs.sh FOLDER [BUILDER]
# Builder `dummy` reads all pages and resolves all links, but writes no page.
set -euo pipefail
rm -rf "${1:?usage: docs.sh FOLDER [BUILDER]}"
cd "$(dirname "${BASH_SOURCE[0]}")/.."
python -m sphinx --quiet --fail-on-warning --fresh-env --jobs auto --builder "${2:-html}" --doctree-dir "$1.doctrees" docs "$1"
rm -rf "$1.doctrees"
