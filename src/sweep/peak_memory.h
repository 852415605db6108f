// The most memory that this process has had at once.
#pragma once

namespace saltus {

// From here on. Where the system does not allow it, the peak stays that since the process began.
void ForgetPeakMemory();

// In MiB, resident; negative where the system does not tell.
double PeakMemory();

}  // namespace saltus
