// What a program does when memory runs out: it can still say so, write what is done, and end with an exit code.
#pragma once

namespace saltus {

// What is said then.
inline constexpr char kMemoryRanOut[] = "memory ran out";

// From now on some memory is held back. The first allocation that fails gives it back and throws std::bad_alloc, so
// that there is memory to take down what was built: destructors of JSON documents allocate. Where the exception cannot
// get out the program says kMemoryRanOut and ends with `exit_code`, as it would have with the exception caught in main.
void HoldMemoryBack(int exit_code);

// Holds memory back again after it ran out, if there is any by now.
void HoldMemoryBackAgain();

}  // namespace saltus
