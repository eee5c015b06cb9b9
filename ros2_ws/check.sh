#!/usr/bin/env bash
# Style, types, import rules, and no path of anybody's machine in the tree. Runs them all, fails if one fails.
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
    # Character classes keep this line from finding itself.
    ! git grep -nIE '(^|[^[:alnum:]_.$}-])/([w]ork|[r]oot|[h]ome|[t]mp)/' -- . ':!*.svg'
}

import_rules() {
    # The linter finds packages on the path of Python; the packages stand one folder down.
    local each path=
    for each in via_*/setup.py; do path=$path${each%/setup.py}:; done
    PYTHONPATH=$path${PYTHONPATH:-} lint-imports --no-cache
}

check "ruff" ruff check --quiet .
check "format" ruff format --check --quiet .
check "types" mypy
check "import rules" import_rules
check "machine paths" no_machine_paths
[ ${#failed[@]} -eq 0 ] || exit 1
