# Source this from bash: the environment of this checkout's packages, independent of a ROS sourced before.
# Used by the Makefile, ./ros2run and tools/setup_environment.py.
_ship_root=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd -P)
_ship_venv=$_ship_root/.venv
unset PYTHONHOME

_ship_join() { # directories that exist, joined by colons, each once
    local joined= directory
    for directory in "$@"; do
        [ -d "$directory" ] || continue
        case ":$joined:" in *":$directory:"*) ;; *) joined=${joined:+$joined:}$directory ;; esac
    done
    printf '%s' "$joined"
}

_ship_sources=() _ship_prefixes=() _ship_python=() _ship_libraries=()
for _ship_package in "$_ship_root"/src/*/ "$_ship_root"/tools/wheels_only/*/; do
    _ship_package=${_ship_package%/}
    _ship_name=${_ship_package##*/}
    # Python packages run from src/; their metadata (executables) is in build/.
    [ -e "$_ship_package/setup.py" ] && _ship_sources+=("$_ship_package") && _ship_python+=("$_ship_root/build/$_ship_name")
    _ship_prefixes+=("$_ship_root/install/$_ship_name")
    _ship_python+=("$_ship_root/install/$_ship_name"/lib/python3*/site-packages
        "$_ship_root/install/$_ship_name"/local/lib/python3*/dist-packages)
    _ship_libraries+=("$_ship_root/install/$_ship_name/lib")
done
_ship_python+=("$_ship_root/test") # ship_testing: trials and helpers that tools and tests share

if [ -f "$_ship_venv/.ros_prefix" ]; then
    # Over a Jazzy installation, whose paths are kept.
    if [ "${ROS_DISTRO:-}" != jazzy ]; then
        case $- in *u*) _ship_u=-u; set +u ;; *) _ship_u= ;; esac
        . "$(cat "$_ship_venv/.ros_prefix")/setup.bash"
        [ -n "$_ship_u" ] && set -u
    fi
    _ship_tail() { [ -n "${1:-}" ] && printf ':%s' "$1"; }
    export AMENT_PREFIX_PATH="$(_ship_join "${_ship_prefixes[@]}")$(_ship_tail "${AMENT_PREFIX_PATH:-}")"
    export CMAKE_PREFIX_PATH="$(_ship_join "${_ship_prefixes[@]}")$(_ship_tail "${CMAKE_PREFIX_PATH:-}")"
    export PYTHONPATH="$(_ship_join "${_ship_sources[@]}" "${_ship_python[@]}")$(_ship_tail "${PYTHONPATH:-}")"
    export LD_LIBRARY_PATH="$(_ship_join "${_ship_libraries[@]}")$(_ship_tail "${LD_LIBRARY_PATH:-}")"
    unset -f _ship_tail
else
    # Over the wheels: remove paths of another ROS. The wheels would set LD_LIBRARY_PATH by starting Python a second
    # time; with the path and their guard variable set here they do not.
    unset ROS_DISTRO ROS_VERSION ROS_PYTHON_VERSION
    export AMENT_PREFIX_PATH="$(_ship_join "${_ship_prefixes[@]}" "$_ship_venv")"
    export CMAKE_PREFIX_PATH=$AMENT_PREFIX_PATH
    export PYTHONPATH="$(_ship_join "${_ship_sources[@]}" "${_ship_python[@]}")"
    export LD_LIBRARY_PATH="$(_ship_join "${_ship_libraries[@]}" "$_ship_venv"/lib "$_ship_venv"/lib/python3*/site-packages/ros_*.libs)"
    export _ROS_WHEELS_BOOTSTRAP_COMPLETE=1
    unset COLCON_PREFIX_PATH
fi
export VIRTUAL_ENV=$_ship_venv
case ":$PATH:" in *":$_ship_venv/bin:"*) ;; *) export PATH="$_ship_venv/bin:$PATH" ;; esac
# The matrices are small: threads of BLAS would only wait for one another.
export OPENBLAS_NUM_THREADS=${OPENBLAS_NUM_THREADS:-1} OMP_NUM_THREADS=${OMP_NUM_THREADS:-1}

unset -f _ship_join
unset _ship_root _ship_venv _ship_sources _ship_prefixes _ship_python _ship_libraries _ship_package _ship_name _ship_u
