// CPU time, which what else the machine does disturbs little.
#pragma once

#include <glog/logging.h>

#include <ctime>

namespace saltus {

// Of this thread, s.
inline double ThreadTime() {
  timespec time;
  CHECK_EQ(clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time), 0);
  return time.tv_sec + 1e-9 * time.tv_nsec;
}

}  // namespace saltus
