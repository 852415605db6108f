// Memory for temporaries of a few contacts, until the end of a function.
#pragma once

#include <array>
#include <cstddef>
#include <memory_resource>

namespace saltus {

// A memory resource with a buffer on the stack, which takes from the heap only once the buffer is full.
class LocalMemory {
 public:
  LocalMemory() = default;
  LocalMemory(const LocalMemory&) = delete;
  LocalMemory& operator=(const LocalMemory&) = delete;

  std::pmr::memory_resource* get() { return &memory_; }

 private:
  alignas(std::max_align_t) std::array<std::byte, 8192> first_;
  std::pmr::monotonic_buffer_resource memory_{first_.data(), first_.size()};
};

}  // namespace saltus
