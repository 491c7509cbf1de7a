# Sourced by the lists of planted bugs: the check that runs nothing, and how a list ends.
# shellcheck shell=bash
# shellcheck disable=SC2154 # tried, caught and tree are the list's

dry=false

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

# The last line, and the list's exit status: 0 when nothing is left over and something was tried.
conclude() {
    local verb=caught
    if $dry; then verb=apply; fi
    echo "$caught of $tried $verb"
    [ "$tried" -gt 0 ] && [ "$caught" -eq "$tried" ]
}
