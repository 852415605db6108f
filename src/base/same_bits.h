// Bitwise comparison of numbers, for which -0 and 0 differ.
#pragma once

#include <cstring>
#include <span>

namespace saltus {

// Precondition: an element has numbers only, without padding.
template <typename Element>
bool SameBits(std::span<const Element> a, std::span<const Element> b) {
  return a.size() == b.size() && (a.empty() || std::memcmp(a.data(), b.data(), a.size_bytes()) == 0);
}

}  // namespace saltus
