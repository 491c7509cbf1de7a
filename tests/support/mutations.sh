# Sourced by the lists of planted bugs: one edit, the check that runs nothing, and how a list ends.
# shellcheck shell=bash
# shellcheck disable=SC2154 # tree, source, pristine, scratch and pattern are the list's

dry=false
tried=0
caught=0

applies_only() {
    dry=true
}

# applies FILE WHAT SED_SCRIPT: counts the edit when it changes its file.
applies() {
    if [ ! -f "$tree/$1" ]; then
        echo "NO FILE    $2 ($1)"
    elif sed "$3" "$tree/$1" | cmp -s "$tree/$1" -; then
        echo "NO CHANGE  $2 ($1)"
    else
        caught=$((caught + 1))
    fi
}

# edit FILE WHAT SED_SCRIPT RUN...: plants a bug in the file below $source, which stands below $pristine
# as it was, and runs what must fail: RUN returns 0 passed, 1 failed, 2 did not build. Fails itself
# unless the bug was caught.
edit() {
    local file=$1 what=$2 script=$3 begin=$SECONDS status=3
    shift 3
    [[ $what == *$pattern* ]] || return
    tried=$((tried + 1))
    if $dry; then
        applies "$file" "$what" "$script"
        return
    fi
    sed -i "$script" "$source/$file"
    if ! cmp -s "$pristine/$file" "$source/$file"; then
        "$@"
        status=$?
    fi
    case $status in
    1) caught=$((caught + 1)) && echo "caught     $what ($((SECONDS - begin)) s)" ;;
    2) echo "NO BUILD   $what" && tail -5 "$scratch/log" ;;
    3) echo "NO CHANGE  $what ($file)" ;;
    *) echo "MISSED     $what ($*)" ;;
    esac
    cp "$pristine/$file" "$source/$file"
    [ "$status" -eq 1 ]
}

# The last line, and the list's exit status: 0 when nothing is left over and something was tried.
conclude() {
    local verb=caught
    if $dry; then verb=apply; fi
    echo "$caught of $tried $verb"
    [ "$tried" -gt 0 ] && [ "$caught" -eq "$tried" ]
}
