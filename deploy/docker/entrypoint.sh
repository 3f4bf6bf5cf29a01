#!/bin/sh
# The root file system is read-only and numba must be able to write where it reads: the kernels that were compiled when
# the image was built are copied (9 MB) to where it looks for them, and the program takes this shell's place.
set -eu
mkdir -p "$NUMBA_CACHE_DIR"
cp -R "$SPLITSLAM_KERNELS/." "$NUMBA_CACHE_DIR"
exec "$@"
