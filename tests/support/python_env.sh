#!/usr/bin/env bash
# Prints the path of a Python interpreter that has the packages of the interoperability tests.
# The environment is made once, in the directory given as the first argument.
set -euo pipefail
environment="$1"
packages=("iceoryx2==0.10.*" "mcap>=1.2,<2" "mcap-ros2-support>=0.5,<1" "mcap-protobuf-support>=0.5,<1")
# Made anew where other packages are wanted.
complete() { [ "$(cat "$environment/complete" 2> /dev/null)" = "${packages[*]}" ]; }
if ! complete; then
    # Tests of one run may come here at the same time.
    mkdir -p "$(dirname "$environment")"
    exec 9>"$environment.lock"
    flock 9
    if ! complete; then
        python3 -m venv --clear "$environment" >&2 || {
            echo "python3 with venv and pip is needed for the interoperability tests (Debian: python3-venv)" >&2
            exit 3
        }
        "$environment/bin/pip" install --quiet --disable-pip-version-check "${packages[@]}" >&2 || {
            echo "pip could not install ${packages[*]}: no package index reachable?" >&2
            exit 3
        }
        echo "${packages[*]}" > "$environment/complete"
    fi
fi
echo "$environment/bin/python"
