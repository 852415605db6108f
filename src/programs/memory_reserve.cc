#include "programs/memory_reserve.h"

#include <unistd.h>

#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <iostream>
#include <new>

namespace saltus {
namespace {

constexpr std::size_t kReserve = std::size_t{32} << 20;  // of the address space; no page of it is ever touched

std::atomic<void*> reserve{nullptr};
std::atomic<bool> holds{false};
int code_of_end = 1;

void OnNoMemory() {
  void* held = reserve.exchange(nullptr);
  std::free(held);
  // Destructors at work may use what was held back, and must not throw.
  if (held != nullptr && std::uncaught_exceptions() > 0) return;
  throw std::bad_alloc();
}

[[noreturn]] void OnTerminate() {
  try {
    if (const std::exception_ptr thrown = std::current_exception()) std::rethrow_exception(thrown);
  } catch (const std::bad_alloc&) {
    std::cout.flush();
    std::fflush(stdout);
    for (const char* text : {"error: ", kMemoryRanOut, "\n"}) (void)!write(STDERR_FILENO, text, std::strlen(text));
    _exit(code_of_end);
  } catch (...) {
  }
  std::abort();
}

}  // namespace

void HoldMemoryBack(int exit_code) {
  code_of_end = exit_code;
  holds = true;
  HoldMemoryBackAgain();
  std::set_new_handler(OnNoMemory);
  std::set_terminate(OnTerminate);
}

void HoldMemoryBackAgain() {
  if (!holds || reserve != nullptr) return;
  std::free(reserve.exchange(std::malloc(kReserve)));
}

}  // namespace saltus
