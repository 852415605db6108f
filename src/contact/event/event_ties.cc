#include "contact/event/event_ties.h"

#include <algorithm>
#include <cstdint>

namespace saltus {
namespace {

int Factorial(int n) { return n < 2 ? 1 : n * Factorial(n - 1); }

// Returns the next number of the generator SplitMix64 (Steele, Lea, Flood 2014).
std::uint64_t Next(std::uint64_t* state) {
  std::uint64_t z = *state += 0x9e3779b97f4a7c15;
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9;
  z = (z ^ (z >> 27)) * 0x94d049bb133111eb;
  return z ^ (z >> 31);
}

}  // namespace

int NumTieOrders(int num_contacts) { return Factorial(std::min(num_contacts, internal::kAllTieOrders)); }

void ArrangeTie(int order, std::span<int> contacts) {
  const int n = static_cast<int>(contacts.size());
  int number = (order - 1) % NumTieOrders(n);
  std::uint64_t state = static_cast<std::uint64_t>(number);
  for (int i = 0; i + 1 < n; ++i) {
    const int left = n - i;
    int chosen;
    if (n <= internal::kAllTieOrders) {
      chosen = number / Factorial(left - 1);
      number %= Factorial(left - 1);
    } else {
      chosen = static_cast<int>(Next(&state) % left);
    }
    std::rotate(contacts.begin() + i, contacts.begin() + i + chosen, contacts.begin() + i + chosen + 1);
  }
}

}  // namespace saltus
