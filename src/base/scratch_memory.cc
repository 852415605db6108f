#include "base/scratch_memory.h"

#include <algorithm>
#include <cstdint>

namespace saltus {
namespace {

constexpr std::size_t kFirstBlock = 1 << 13;

}  // namespace

void ScratchMemory::AddBlock(std::size_t size) {
  blocks_.push_back({std::make_unique_for_overwrite<std::byte[]>(size), size});
  UseLastBlock();
}

void ScratchMemory::UseLastBlock() {
  next_ = blocks_.back().data.get();
  left_ = blocks_.back().size;
}

void* ScratchMemory::do_allocate(std::size_t bytes, std::size_t alignment) {
  if (blocks_.empty()) AddBlock(kFirstBlock);
  while (true) {
    const std::uintptr_t address = reinterpret_cast<std::uintptr_t>(next_);
    const std::size_t padding = -address & (alignment - 1);  // alignment is a power of two
    if (bytes + padding <= left_) {
      std::byte* const at = next_ + padding;
      next_ = at + bytes;
      left_ -= bytes + padding;
      return at;
    }
    AddBlock(std::max(2 * blocks_.back().size, bytes + alignment));
  }
}

void ScratchMemory::Release() {
  if (blocks_.empty()) return;
  UseLastBlock();
  if (blocks_.size() == 1) return;
  std::size_t total = 0;
  for (const Block& block : blocks_) total += block.size;
  blocks_.clear();
  AddBlock(total);
}

}  // namespace saltus
