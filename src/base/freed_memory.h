// Freed memory, which a process keeps for what it allocates next.
#pragma once

#include <cstdlib>  // __GLIBC__

#ifdef __GLIBC__
#include <malloc.h>
#endif

namespace saltus {

// Keeps up to 64 MiB of what is freed for the next allocation. Solves with sparse matrices allocate the same megabytes
// for each iteration; given back to the system each time, they return page by page, which may take longer than all
// arithmetic. Without glibc this does nothing.
inline void KeepFreedMemory() {
#ifdef __GLIBC__
  mallopt(M_MMAP_THRESHOLD, 32 << 20);  // the largest that glibc accepts
  mallopt(M_TRIM_THRESHOLD, 64 << 20);
#endif
}

}  // namespace saltus
