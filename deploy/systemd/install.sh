#!/usr/bin/env bash
# Installs SplitSLAM on a robot (edge-agent) or a rack (--service: map-service), upgrades it, rolls it back.
#
#   install.sh WHEEL [--wheelhouse DIR | --packages-from DIR] [--with-fpga] [--service] [--no-kernels]
#   install.sh --rollback
#   common: [--root DIR] [--python PROGRAM] [--dry-run]
#
# Each version has a folder of its own, /opt/splitslam/VERSION; `current` and `previous` are links to two of them.
# Configuration (/etc/splitslam), state and spool (/var/lib/splitslam) belong to none and are never written over.
set -euo pipefail
umask 022

readonly HERE=$(cd "$(dirname "$0")" && pwd)
readonly ACCOUNT=splitslam
readonly NEEDED_MB=900 # the edge with its packages takes 540 MB, pip's temporary files come on top
readonly KEPT=3         # versions, current and previous among them

usage() { sed -n '2,6s/^# \{0,1\}//p' "$0"; }
die() { echo "install.sh: $*" >&2; exit "${STATUS:-2}"; }
say() { echo "install.sh: $*"; }
# Does what changes something, or says that it would.
run() { if [[ $DRY ]]; then echo "would: $*"; else "$@"; fi; }

WHEEL='' WHEELHOUSE='' PACKAGES='' FPGA='' SERVICE='' ROLLBACK='' KERNELS=1 ROOT='' PYTHON='' DRY=''

parse() {
    while (($#)); do
        case $1 in
            --wheelhouse | --packages-from | --root | --python)
                [[ ${2-} ]] || die "$1: expected a value after it"
                case $1 in
                    --wheelhouse) WHEELHOUSE=$2 ;;
                    --packages-from) PACKAGES=$2 ;;
                    --root) ROOT=${2%/} ;;
                    --python) PYTHON=$2 ;;
                esac
                shift
                ;;
            --with-fpga) FPGA=1 ;;
            --service) SERVICE=1 ;;
            --rollback) ROLLBACK=1 ;;
            --no-kernels) KERNELS='' ;;
            --dry-run) DRY=1 ;;
            -h | --help) usage; exit 0 ;;
            -*) die "unknown option $1 (see --help)" ;;
            *) [[ ! $WHEEL ]] || die "expected one wheel, found $WHEEL and $1"; WHEEL=$1 ;;
        esac
        shift
    done
    [[ $ROLLBACK || $WHEEL ]] || die "expected a wheel or --rollback (see --help)"
    [[ ! $ROLLBACK || ! $WHEEL ]] || die "--rollback takes no wheel"
    [[ ! $WHEELHOUSE || ! $PACKAGES ]] || die "expected one of --wheelhouse and --packages-from"
    if [[ $ROOT ]]; then ROOT=$(cd "$ROOT" 2>/dev/null && pwd) || die "--root: no such folder"; fi
    BASE=$ROOT/opt/splitslam CONFIG=$ROOT/etc/splitslam STATE=$ROOT/var/lib/splitslam
    CACHE=$ROOT/var/cache/splitslam UNITS=$ROOT/etc/systemd/system
    UNIT=edge-agent EXTRA=edge YAML=edge.yaml
    if [[ $SERVICE ]]; then UNIT=map-service EXTRA=server YAML=map.yaml; fi
    # What was installed with the overlay is upgraded with it.
    if [[ $WHEEL && ! $FPGA && -e $UNITS/$UNIT.service.d/fpga.conf ]]; then say "with --with-fpga, as before"; FPGA=1; fi
}

# --- what can be known before anything is touched ---------------------------------------------------------------------

check_machine() {
    case $(uname -m) in x86_64 | aarch64) ;; *) die "$(uname -m): expected x86_64 or aarch64" ;; esac
    [[ $ROOT || $DRY || $EUID -eq 0 ]] || die "expected to run as root, or with --root DIR"
}

check_wheel() {
    [[ -f $WHEEL ]] || die "$WHEEL: no such file; expected splitslam-VERSION-py3-none-any.whl"
    local name=${WHEEL##*/}
    [[ $name =~ ^splitslam-([0-9][0-9A-Za-z.+]*)-py3-none-any\.whl$ ]] \
        || die "$WHEEL: expected splitslam-VERSION-py3-none-any.whl"
    VERSION=${BASH_REMATCH[1]} TARGET=$BASE/${BASH_REMATCH[1]}
    [[ ! $WHEELHOUSE || -d $WHEELHOUSE ]] || die "--wheelhouse $WHEELHOUSE: no such folder"
    [[ ! $PACKAGES || -d $PACKAGES ]] || die "--packages-from $PACKAGES: no such folder"
}

check_python() {
    local candidate
    if [[ $FPGA && ! $PYTHON ]]; then PYTHON=/usr/local/share/pynq-venv/bin/python3; fi
    for candidate in ${PYTHON:-python3 python3.12 python3.11}; do
        if "$candidate" -c 'import ensurepip, sys, venv; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 12))' \
            2>/dev/null; then PYTHON=$candidate; break; fi
        [[ $PYTHON != "$candidate" ]] || die "--python $candidate: expected Python 3.11 or 3.12 with the venv module"
    done
    [[ $PYTHON ]] || die "expected python3 3.11 or 3.12 with venv (Debian: apt-get install python3-venv)"
    "$PYTHON" -m zipfile -t "$WHEEL" >/dev/null 2>&1 || die "$WHEEL: damaged: not a whole zip file"
    if [[ $FPGA ]]; then
        PYNQ=$("$PYTHON" -c 'import importlib.util as u, os; print(os.path.dirname(u.find_spec("pynq").submodule_search_locations[0]))' \
            2>/dev/null) || die "--with-fpga: no pynq for $PYTHON; expected PYNQ 4.0's Python (--python)"
    fi
}

check_disk() {
    local at=$BASE free_mb
    [[ ! $PACKAGES ]] || return 0
    while [[ ! -d $at ]]; do at=$(dirname "$at"); done
    free_mb=$(df -Pm "$at" | awk 'NR == 2 {print $4}')
    ((free_mb >= NEEDED_MB)) || STATUS=1 die "$at: $free_mb MB are free, expected $NEEDED_MB MB"
}

# --- one version ------------------------------------------------------------------------------------------------------

# Runs a command whose output nobody reads unless it fails: then its last line is the reason, the rest is in a file.
quietly() {
    local what=$1 log=$BASE/install.log
    shift
    if [[ $DRY ]]; then echo "would: $*"; return; fi
    "$@" >"$log" 2>&1 || STATUS=1 die "$what: $(grep -v '^$' "$log" | grep -m1 -i error || tail -n1 "$log") (log: $log)"
}

install_version() {
    local sum
    sum=$(sha256sum "$WHEEL" | cut -d' ' -f1)
    if [[ -f $TARGET/installed ]]; then
        [[ $(cat "$TARGET/installed") == "$sum" ]] \
            || die "$VERSION is installed from another wheel of that version; expected one with a version of its own"
        say "$VERSION is installed already"
    else
        check_disk
        run rm -rf "$TARGET" # what an installation that was cut off has left
        run mkdir -p "$BASE"
        quietly "venv" "$PYTHON" -m venv "$TARGET"
        install_packages
        run cp -r "$HERE" "$TARGET/systemd"
        if [[ ! $DRY ]]; then
            echo "NUMBA_CACHE_DIR=${CACHE#"$ROOT"}/$VERSION" >"$TARGET/environment"
            echo "$sum" >"$TARGET/installed"
        fi
    fi
}

install_packages() {
    local pip=("$TARGET/bin/python" -m pip --disable-pip-version-check install --quiet)
    if [[ $WHEELHOUSE ]]; then pip+=(--no-index --find-links "$WHEELHOUSE"); fi
    if [[ $FPGA ]]; then
        # PYNQ has an environment of its own, and pins these; ours finds it behind its own packages.
        pip+=('numpy<2' 'grpcio==1.64.0' 'protobuf<6')
        add_path "$PYNQ"
    elif [[ -f $HERE/../../requirements/lock.txt && ! $WHEELHOUSE && ! $PACKAGES ]]; then
        pip+=(--constraint "$HERE/../../requirements/lock.txt")
    fi
    if [[ $PACKAGES ]]; then
        add_path "$PACKAGES"
        quietly "pip" "${pip[@]}" --no-deps --no-index "$WHEEL"
    else
        quietly "pip" "${pip[@]}" "$WHEEL[$EXTRA]"
    fi
}

add_path() {
    local site
    if [[ $DRY ]]; then echo "would: packages of $1 after its own"; return; fi
    site=$("$TARGET/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
    (cd "$1" && pwd) >"$site/other-packages.pth"
}

# --- what all versions share ------------------------------------------------------------------------------------------

make_account() {
    [[ ! $ROOT ]] || return 0
    getent passwd $ACCOUNT >/dev/null \
        || run useradd --system --user-group --home-dir /var/lib/splitslam --no-create-home --shell /usr/sbin/nologin $ACCOUNT
}

owned() { [[ $ROOT ]] || run chown -R $ACCOUNT:$ACCOUNT "$@"; }

make_folders() {
    run install -d -m 0750 "$CONFIG" "$STATE" "$STATE/recordings" "$CACHE"
    [[ $ROOT ]] || run chgrp $ACCOUNT "$CONFIG"
    [[ $ROOT ]] || run chown $ACCOUNT:$ACCOUNT "$STATE" "$STATE/recordings" "$CACHE"
    if [[ ! -e $CONFIG/$YAML ]]; then
        run install -m 0640 "$HERE/$YAML" "$CONFIG/$YAML"
        [[ $ROOT ]] || run chgrp $ACCOUNT "$CONFIG/$YAML"
        say "$CONFIG/$YAML is an example: edit it before the first start"
        FIRST=1
    fi
}

fill_kernels() {
    [[ $KERNELS ]] || return 0
    local as=() report
    [[ $ROOT ]] || as=(runuser -u $ACCOUNT --)
    run install -d -m 0750 "$CACHE/$VERSION"
    owned "$CACHE/$VERSION"
    if [[ $DRY ]]; then echo "would: $UNIT warm-up into $CACHE/$VERSION"; return; fi
    say "compiling kernels for this processor: minutes on a small board, once a version"
    report=$("${as[@]}" env "NUMBA_CACHE_DIR=$CACHE/$VERSION" "$TARGET/bin/$UNIT" warm-up 2>"$BASE/install.log") \
        || STATUS=1 die "kernels: $(tail -n1 "$BASE/install.log") (log: $BASE/install.log)"
    say "kernels: $report"
}

# A configuration that the new version does not take is found before anything is switched.
check_config() {
    [[ ! ${FIRST-} && ! $DRY ]] || return 0
    local verb=run said
    [[ ! $SERVICE ]] || verb=serve
    said=$("$TARGET/bin/$UNIT" $verb --config "$CONFIG/$YAML" --print-config 2>&1 >/dev/null) || die "$VERSION: $said"
}

version_of() { [[ -L $BASE/$1 ]] && readlink "$BASE/$1" || true; }

# The link is replaced in one step: whoever starts meanwhile gets one version or the other.
point() {
    run ln -sfn "$2" "$BASE/.$1"
    run mv -T "$BASE/.$1" "$BASE/$1"
}

place_units() {
    local from=$BASE/$1/systemd
    if [[ $DRY ]]; then echo "would: units of $1 into $UNITS"; return; fi
    install -d "$UNITS"
    install -m 0644 "$from/$UNIT.service" "$UNITS/$UNIT.service"
    if [[ $FPGA ]]; then install -D -m 0644 "$from/$UNIT.service.d/fpga.conf" "$UNITS/$UNIT.service.d/fpga.conf"; fi
}

switch_to() {
    local now
    now=$(version_of current)
    if [[ $now && $now != "$1" ]]; then point previous "$now"; fi
    point current "$1"
    place_units "$1"
}

prune() {
    local kept=0 folder name
    while read -r folder; do
        name=${folder##*/}
        if [[ $name == $(version_of current) || $name == $(version_of previous) ]] || ((++kept <= KEPT - 2)); then continue; fi
        say "removing $name"
        run rm -rf "$folder" "${CACHE:?}/$name"
    done < <(for file in "$BASE"/*/installed; do [[ -e $file && ! -L ${file%/installed} ]] && dirname "$file"; done | sort -Vr)
}

# --- the running service ----------------------------------------------------------------------------------------------

manager() { [[ ! $ROOT || ${SPLITSLAM_SYSTEMCTL-} ]]; } # with --root there is none, unless a test brings one
systemctl() { run "${SPLITSLAM_SYSTEMCTL:-/usr/bin/systemctl}" "$@"; }

# Type=notify: a restart that returns has a service that is ready. One that does not, does not stay.
restart() {
    local back=$1
    manager || return 0
    systemctl daemon-reload
    [[ $DRY ]] || command "${SPLITSLAM_SYSTEMCTL:-/usr/bin/systemctl}" is-active --quiet "$UNIT" || return 0
    if systemctl restart "$UNIT"; then return 0; fi
    [[ $back ]] || STATUS=1 die "$(version_of current) does not start: journalctl -u $UNIT"
    switch_to "$back"
    systemctl daemon-reload
    systemctl restart "$UNIT" || true
    STATUS=1 die "$VERSION does not start, $back is back: journalctl -u $UNIT"
}

main() {
    parse "$@"
    check_machine
    if [[ $ROLLBACK ]]; then
        VERSION=$(version_of previous)
        [[ -L $BASE/current ]] || die "--rollback: no version is installed in $BASE"
        [[ $VERSION ]] || die "--rollback: there is no version before $(version_of current)"
        switch_to "$VERSION"
        restart ''
        say "$VERSION is current"
        return
    fi
    check_wheel
    check_python
    run mkdir -p "$BASE"
    if [[ ! $DRY ]]; then
        exec 9>"$BASE/.lock"
        flock -n 9 || STATUS=1 die "another installation is running"
    fi
    make_account
    make_folders
    install_version
    fill_kernels
    check_config
    local before
    before=$(version_of current)
    [[ $before != "$VERSION" ]] || before=''
    switch_to "$VERSION"
    manager && systemctl enable --quiet "$UNIT"
    restart "$before"
    prune
    say "$VERSION is current${before:+, before it $before}"
}

main "$@"
