#include "sweep/peak_memory.h"

#include <fstream>
#include <string>

namespace saltus {

// Linux, proc(5): 5 in clear_refs resets the peak, VmHWM in status is it.
void ForgetPeakMemory() { std::ofstream("/proc/self/clear_refs") << "5"; }

double PeakMemory() {
  std::ifstream status("/proc/self/status");
  for (std::string word; status >> word;) {
    double kib = 0;
    if (word == "VmHWM:" && status >> kib) return kib / 1024;
  }
  return -1;
}

}  // namespace saltus
