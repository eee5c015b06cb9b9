#!/usr/bin/env bash
# Checks style, types, import rules, the documentation site, and that no file names a path of a particular machine.
# Fails if one check fails.
cd "$(dirname "${BASH_SOURCE[0]}")/.." || exit 1
failed=()

check() {
    local title=$1 output
    shift
    if output=$("$@" 2>&1); then
        echo "check: $title: fine"
    else
        printf '%s\n' "$output" | cut -c1-400; printf 'check: %s: FAILED (%s)\n' "$title" "$*"
        failed+=("$title")
    fi
}

no_machine_paths() {
    # The character classes prevent a match with this line itself.
    ! git grep -nIE '(^|[^[:alnum:]_.$}-])/([w]ork|[r]oot|[h]ome|[t]mp)/' -- . ':!*.svg'
}

plain_terms() {
    # Words that the project replaced by terms of the field; CHANGELOG and published results may name what was.
    ! git grep -nP -f ros2_ws/terms.txt -- . ':!ros2_ws/terms.txt' ':!CHANGELOG.md' ':!docs/results' ':!*LICENSE'
}

import_rules() {
    # The linter finds packages through PYTHONPATH; each package is one folder below its project folder.
    local each path=
    for each in via_*/setup.py; do path=$path${each%/setup.py}:; done
    PYTHONPATH=$path${PYTHONPATH:-} lint-imports --no-cache
}

check "ruff" ruff check --quiet .
check "format" ruff format --check --quiet .
check "types" mypy
check "import rules" import_rules
check "machine paths" no_machine_paths
check "plain terms" plain_terms
check "documentation site" ros2_ws/docs.sh out/check/docs dummy
[ ${#failed[@]} -eq 0 ] || exit 1
