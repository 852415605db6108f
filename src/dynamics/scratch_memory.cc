#include "saltus/dynamics/scratch_memory.h"

#include <algorithm>

namespace saltus {
namespace {

constexpr std::size_t kFirstBlock = 1 << 13;

}  // namespace

void ScratchMemory::AddBlock(std::size_t size) {
  blocks_.push_back({std::make_unique_for_overwrite<std::byte[]>(size), size});
  used_ = 0;
}

void* ScratchMemory::do_allocate(std::size_t bytes, std::size_t alignment) {
  if (blocks_.empty()) AddBlock(kFirstBlock);
  const auto align = [&] {
    void* at = blocks_.back().data.get() + used_;
    std::size_t left = blocks_.back().size - used_;
    if (std::align(alignment, bytes, at, left) == nullptr) return static_cast<void*>(nullptr);
    used_ = blocks_.back().size - left + bytes;
    return at;
  };
  if (void* at = align()) return at;
  AddBlock(std::max(2 * blocks_.back().size, bytes + alignment));
  return align();
}

void ScratchMemory::Release() {
  used_ = 0;
  if (blocks_.size() < 2) return;
  std::size_t total = 0;
  for (const Block& block : blocks_) total += block.size;
  blocks_.clear();
  AddBlock(total);
}

}  // namespace saltus
