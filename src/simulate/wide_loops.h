// Loops over the numbers of a control that take several at a time: with AVX2 if the processor has it, otherwise with
// what the build is for, and with the same bits.
#pragma once

#include <array>
#include <cstddef>
#include <cstring>

#include "saltus/internal/lanes.h"

namespace saltus {
namespace internal {

#ifdef __x86_64__
template <typename F>
SALTUS_FLATTEN [[gnu::target("avx2")]] void RunWithAvx2(const F& f) {
  f();
}
#endif

// Calls f, compiled for the widest instructions of the processor.
template <typename F>
void RunWide(const F& f) {
#ifdef __x86_64__
  if (__builtin_cpu_supports("avx2")) return RunWithAvx2(f);
#endif
  f();
}

// Packs two numbers in each of two steps that are `stride` numbers apart.
template <typename S>
struct StepPairs {
  using Pair [[gnu::vector_size(2 * sizeof(S))]] = S;
  using Pack [[gnu::vector_size(4 * sizeof(S))]] = S;

  // Returns by pointer, as the caller may be compiled without registers of that width.
  static void Load(const S* at, std::ptrdiff_t stride, Pack* pack) {
    if (stride == 2) {
      std::memcpy(pack, at, sizeof(Pack));
      return;
    }
    Pair pairs[2];
    std::memcpy(&pairs[0], at, sizeof(Pair));
    std::memcpy(&pairs[1], at + stride, sizeof(Pair));
    *pack = __builtin_shufflevector(pairs[0], pairs[1], 0, 1, 2, 3);
  }
  static void Store(const Pack& pack, std::ptrdiff_t stride, S* at) {
    if (stride == 2) {
      std::memcpy(at, &pack, sizeof(Pack));
      return;
    }
    const Pair pairs[] = {__builtin_shufflevector(pack, pack, 0, 1), __builtin_shufflevector(pack, pack, 2, 3)};
    std::memcpy(at, &pairs[0], sizeof(Pair));
    std::memcpy(at + stride, &pairs[1], sizeof(Pair));
  }
};

}  // namespace internal

// Returns the sums of the squares of several rows of n numbers. Each is the total of four sums of every fourth number,
// which the processor computes in parallel; the order of additions does not depend on the number of rows.
template <std::size_t kRows>
std::array<double, kRows> SumsOfSquares(const std::array<const double*, kRows>& rows, std::size_t n) {
  std::array<double, kRows> all;
  internal::RunWide([&] {
    Lanes::Pack sums[kRows] = {};
    std::size_t i = 0;
    for (; i + kLanes <= n; i += kLanes) {
      for (std::size_t row = 0; row < kRows; ++row) {
        Lanes::Pack x;
        std::memcpy(&x, rows[row] + i, sizeof(x));
        sums[row] += x * x;
      }
    }
    for (std::size_t row = 0; row < kRows; ++row) {
      Lanes::Pack& sum = sums[row];
      for (std::size_t rest = i; rest < n; ++rest) sum[0] += rows[row][rest] * rows[row][rest];
      all[row] = (sum[0] + sum[1]) + (sum[2] + sum[3]);
    }
  });
  return all;
}

}  // namespace saltus
