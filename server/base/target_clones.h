// Functions compiled for several instruction sets, the best of which is chosen when the program
// starts.
//
// Only for functions whose result is the same on each: every operation rounds alone and sums are
// taken in one order, or in integers.
#pragma once

// What chooses runs before the sanitizers do and must not be instrumented.
// HOROPTER_THREAD_SANITIZER is of the preset `tsan`, which undefines the compiler's own word
// (tests/support/tsan.supp).
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && \
    !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__) && \
    !defined(HOROPTER_THREAD_SANITIZER)
#define HOROPTER_TARGET_CLONES __attribute__((target_clones("avx2", "default")))
#else
#define HOROPTER_TARGET_CLONES
#endif
