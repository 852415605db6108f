// Whether numbers are the same to the last bit: -0 is not 0.
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
