// Memory for the temporaries of a step: handed out in a row, released all at once, and kept for the next step.
#pragma once

#include <any>
#include <array>
#include <cstddef>
#include <memory>
#include <memory_resource>
#include <vector>

namespace saltus {

// After the largest step has been seen once, no allocation reaches the heap.
class ScratchMemory final : public std::pmr::memory_resource {
 public:
  // Takes back everything that was handed out.
  void Release();

  // An object that survives Release(), for data that one step keeps for the next. It is made by the first call; all
  // users of one memory ask for the same type.
  template <typename T>
  T& Kept() {
    if (!kept_.has_value()) kept_ = T();
    return std::any_cast<T&>(kept_);
  }

 private:
  struct Block {
    std::unique_ptr<std::byte[]> data;
    std::size_t size;
  };

  void* do_allocate(std::size_t bytes, std::size_t alignment) override;
  void do_deallocate(void*, std::size_t, std::size_t) override {}
  bool do_is_equal(const std::pmr::memory_resource& other) const noexcept override { return this == &other; }
  void AddBlock(std::size_t size);
  void UseLastBlock();

  std::vector<Block> blocks_;  // one, unless a step has needed more; the last is in use
  std::byte* next_ = nullptr;  // what is free of the last block
  std::size_t left_ = 0;
  std::any kept_;
};

// A memory resource for temporaries of a few contacts, until the end of a function: a buffer on the stack, which takes
// from the heap only once the buffer is full.
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
