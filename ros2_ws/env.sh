# Source this in bash or zsh. Sets the virtual environment, the workspace and safe defaults; puts `via` on the PATH.
# shellcheck shell=bash disable=SC1091

_via_ws=$(cd "$(dirname "${BASH_SOURCE[0]:-$0}")" && pwd)
_via_venv=$(dirname "$_via_ws")/.venv

# Setup files of ROS read unset variables, which `set -u` would not allow.
case $- in *u*) _via_nounset=1 && set +u ;; *) _via_nounset= ;; esac

if [ -f "$_via_venv/bin/activate" ]; then
    . "$_via_venv/bin/activate"
    if [ -d "$_via_venv/share/rcl_interfaces" ]; then
        # ROS from wheels. Without LD_LIBRARY_PATH and the bootstrap flag, every Python process restarts itself to set
        # them. A child that inherits only one of them cannot load ROS, so both are set here.
        _via_libraries=$_via_venv/lib
        for _via_each in "$_via_venv"/lib/python3.1[123]/site-packages/ros_*.libs; do
            _via_libraries=$_via_libraries:$_via_each
        done
        export AMENT_PREFIX_PATH=$_via_venv
        export LD_LIBRARY_PATH=$_via_libraries
        export _ROS_WHEELS_BOOTSTRAP_COMPLETE=1
        export ROS_DISTRO=jazzy ROS_VERSION=2 ROS_PYTHON_VERSION=3
        unset _via_libraries _via_each
    fi
fi
# setup.bash also sources the Jazzy that the workspace was built on. The wheels have no such file.
_via_setup=setup
if [ -n "${_ROS_WHEELS_BOOTSTRAP_COMPLETE:-}" ]; then _via_setup=local_setup; fi
if [ -n "${ZSH_VERSION:-}" ]; then _via_setup=$_via_setup.zsh; else _via_setup=$_via_setup.bash; fi
if [ -f "$_via_ws/install/$_via_setup" ]; then
    . "$_via_ws/install/$_via_setup"
else
    echo "env.sh: the workspace is not built yet; run: make setup" >&2
fi

# Every process imports the packages from the same folders, those of the sources: numba caches kernels by path.
_via_root=$(dirname "$_via_ws")
for _via_each in "$_via_root"/via_*/setup.py; do
    PYTHONPATH=${_via_each%/setup.py}${PYTHONPATH:+:$PYTHONPATH}
done
export PYTHONPATH

# Each state of the sources has its own cache of compiled kernels. numba checks only the file that defines a kernel, and
# would run outdated code after a constant or function of another file has changed. Nodes, commands and exports define no
# kernels, and kernels import none of them.
_via_key=$(find "$_via_root"/via_*/via_* \( -name via_bringup -o -name via_export -o -name via_ros -o -name nodes \) -prune \
    -o -name '*.py' -print | LC_ALL=C sort | xargs -d '\n' cat | cksum | cut -d' ' -f1)
case ${NUMBA_CACHE_DIR:-} in '' | "$_via_root"/.numba_cache/*) export NUMBA_CACHE_DIR=$_via_root/.numba_cache/$_via_key ;; esac

# Nodes are found on this host only; `export ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET` opens them to the network.
export ROS_AUTOMATIC_DISCOVERY_RANGE=${ROS_AUTOMATIC_DISCOVERY_RANGE:-LOCALHOST}

# Without a writable home directory, logs of ROS go to the workspace.
if [ ! -w "${HOME:-}" ]; then
    export ROS_LOG_DIR=${ROS_LOG_DIR:-$_via_ws/log/ros} MPLCONFIGDIR=${MPLCONFIGDIR:-$_via_ws/log/matplotlib}
fi

if [ -n "$_via_nounset" ]; then set -u; fi
unset _via_ws _via_root _via_key _via_venv _via_setup _via_each _via_nounset
