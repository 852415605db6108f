// The pieces of a user's struct with switches, as the modes of a struct without any.
//
// With K switches at most in a mode, each mode has 2^K pieces: piece number `mode + M sides` of M modes, where bit k of
// `sides` is set if switch k is above zero. Its last guards are the switches, whose resets lead to the piece beside it.
#pragma once

#include <algorithm>
#include <array>
#include <string>

namespace saltus {

template <typename S>
struct SwitchedPieces {
  using Base = S;
  static constexpr int kModes = static_cast<int>(S::kStateSizes.size());
  static constexpr int kMostSwitches = *std::max_element(S::kNumSwitches.begin(), S::kNumSwitches.end());
  static_assert(S::kNumSwitches.size() == S::kStateSizes.size(), "kNumSwitches has one number for each mode");
  static_assert(kMostSwitches > 0 && kMostSwitches <= 6, "kNumSwitches: 1 to 6 switches in a mode are supported");
  static constexpr int kPieces = 1 << kMostSwitches;

  static constexpr int kNumControls = S::kNumControls;
  static constexpr int kNumParameters = S::kNumParameters;
  static constexpr auto kStateSizes = [] {
    std::array<int, kModes * kPieces> sizes{};
    for (int i = 0; i < kModes * kPieces; ++i) sizes[i] = S::kStateSizes[i % kModes];
    return sizes;
  }();
  static constexpr auto kNumGuards = [] {
    std::array<int, kModes * kPieces> guards{};
    for (int i = 0; i < kModes * kPieces; ++i) guards[i] = S::kNumGuards[i % kModes] + S::kNumSwitches[i % kModes];
    return guards;
  }();

  static int NumSwitches(int piece) { return S::kNumSwitches[piece % kModes]; }
  static int SwitchOf(int piece, int guard) { return guard - S::kNumGuards[piece % kModes]; }
  static int AdjacentPiece(int piece, int guard) {
    return (piece / kModes ^ 1 << SwitchOf(piece, guard)) * kModes + piece % kModes;
  }
  static std::string SwitchName(int piece, int guard) {
    int number = SwitchOf(piece, guard);
    if constexpr (requires { S::kSwitchNames; }) {
      for (int mode = 0; mode < piece % kModes; ++mode) number += S::kNumSwitches[mode];
      return S::kSwitchNames[number];
    } else {
      return "switch " + std::to_string(number);
    }
  }
  static std::array<bool, kMostSwitches> SwitchSides(int piece) {
    std::array<bool, kMostSwitches> above{};
    for (int i = 0; i < kMostSwitches; ++i) above[i] = (piece / kModes >> i & 1) != 0;
    return above;
  }

  template <typename T>
  int PieceAt(int mode, const T& t, const T* x, const T* p) const {
    int sides = 0;
    for (int i = 0; i < S::kNumSwitches[mode]; ++i) {
      if (system.Switch(mode, i, t, x, p) >= T(0.0)) sides |= 1 << i;
    }
    return sides * kModes + mode;
  }
  template <typename T>
  void Flow(int piece, const T& t, const T* x, const T* u, const T* p, T* xdot) const {
    const auto above = SwitchSides(piece);
    system.Flow(piece % kModes, t, x, u, p, above.data(), xdot);
  }
  template <typename T>
  T Guard(int piece, int guard, const T& t, const T* x, const T* p) const {
    const int mode = piece % kModes, number = SwitchOf(piece, guard);
    if (number < 0) return system.Guard(mode, guard, t, x, p);
    const T value = system.Switch(mode, number, t, x, p);
    return SwitchSides(piece)[number] ? value : -value;
  }
  template <typename T>
  int Reset(int piece, int guard, const T& t, const T* x, const T* p, T* x_plus) const {
    const int mode = piece % kModes;
    if (SwitchOf(piece, guard) >= 0) {
      std::copy_n(x, S::kStateSizes[mode], x_plus);
      return AdjacentPiece(piece, guard);
    }
    const int next = system.Reset(mode, guard, t, x, p, x_plus);
    return next >= 0 && next < kModes ? PieceAt(next, t, x_plus, p) : next < 0 ? next : kModes * kPieces;
  }
  template <typename T>
  bool Fly(int piece, const T& t, const T& s, const T* x, const T* u, const T* p, T* after) const
      requires(requires(const S& a, const bool* above) { a.Fly(0, t, s, x, u, p, above, after); }) {
    const auto above = SwitchSides(piece);
    return system.Fly(piece % kModes, t, s, x, u, p, above.data(), after);
  }
  int OnAccumulation(int piece, int guard) const {
    if constexpr (requires(const S& a) { a.OnAccumulation(0, 0); }) {
      return SwitchOf(piece, guard) < 0 ? system.OnAccumulation(piece % kModes, guard) : -1;
    } else {
      return -1;
    }
  }

  S system;
};

}  // namespace saltus
