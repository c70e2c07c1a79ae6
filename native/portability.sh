#!/bin/sh
# The C tests with every compiler that is there; says which are missing, and fails when a test does, or when none is there.
set -u
cd "$(dirname "$0")"
log=build/portability.log
seconds=${FUZZ_SECONDS:-5}
ran=0 missing=0 failed=0
mkdir -p build

# try NAME PACKAGES CC [variable=value ...]: skipped when CC, with `sanitize`, cannot build a program
try() {
    name=$1 packages=$2 compiler=$3
    shift 3
    printf 'int main(void) { return 0; }\n' >build/portability.c
    if ! $compiler $sanitize -o build/portability.out build/portability.c -lm >/dev/null 2>&1 || ! command -v ${emulator:-true} >/dev/null; then
        printf '%-28s missing: install %s\n' "$name" "$packages"
        missing=$((missing + 1))
        return
    fi
    if make BUILD="build/$name" CC="$compiler" "$@" FUZZ_SECONDS="$seconds" test fuzz >"$log" 2>&1; then
        printf '%-28s passed, %s checks\n' "$name" "$(awk '/ passed, /{ n += $2 } END { print n }' "$log")"
        ran=$((ran + 1))
    else
        printf '%-28s FAILED\n' "$name"
        grep -E 'error|failed|fuzz:|SUMMARY' "$log" | grep -v ' 0 failed' | head -n 20
        failed=$((failed + 1))
    fi
}

emulator= sanitize=-fsanitize=address,undefined
try gcc gcc gcc
try clang "clang and its libclang-rt-dev" clang
try gcc-m32-x87 gcc-multilib "gcc -m32 -mfpmath=387"
# sanitizers do not run under emulation; gcc 12 for this machine breaks down while it vectorises a loop of test_solve.c
emulator=qemu-aarch64 sanitize=
try aarch64 "gcc-aarch64-linux-gnu, libc6-dev-arm64-cross and qemu-user" "aarch64-linux-gnu-gcc -static" \
    SANITIZE= TEST_FLAGS=-fno-tree-vectorize RUN=qemu-aarch64
printf '%d passed, %d failed, %d missing\n' "$ran" "$failed" "$missing"
[ "$failed" -eq 0 ] && [ "$ran" -gt 0 ]
