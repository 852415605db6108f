// The states of a rollout within a budget of memory.
//
// The steps are cut into windows of equal length. One window is held in full; of the others only the state at their
// beginning (two-level checkpointing), from which they are simulated again when they are asked for, with the same bits.
// A window is large enough to hold a short rollout whole, and small enough to stay in the processor's cache, which a
// long rollout that is written to memory in full would not.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <span>
#include <vector>

namespace saltus {

// Bytes of states that are held in full unless the number of checkpoints asks for more.
inline constexpr std::size_t kWindowBytes = std::size_t{1} << 18;

// The length of a window, in steps, for `steps` steps with states of `state_bytes` each: at least kWindowBytes, and the
// shortest for which window and checkpoints take at most `limit` bytes, if there is one; otherwise that which takes the
// least.
inline int WindowLength(int steps, std::size_t state_bytes, std::size_t limit) {
  const auto bytes = [&](int length) {
    return (static_cast<std::size_t>(length) + (steps + length - 1) / length) * state_bytes;
  };
  const int cached = static_cast<int>(std::min<std::size_t>(kWindowBytes / state_bytes, steps));
  const int balanced = static_cast<int>(std::ceil(std::sqrt(steps)));
  int length = std::clamp(cached, 1, steps);
  while (length < balanced && bytes(length) > limit) length = std::min(2 * length, balanced);
  while (length > balanced && bytes(length) > limit) length = std::max(length / 2, balanced);
  return length;
}

template <typename State>
class Trajectory {
 public:
  void Resize(int num_bodies, int num_steps, std::size_t limit) {
    num_bodies_ = num_bodies;
    num_steps_ = num_steps;
    length_ = WindowLength(num_steps, num_bodies * sizeof(State), limit);
    window_.resize(static_cast<std::size_t>(length_ + 1) * num_bodies);
    checkpoints_.resize(static_cast<std::size_t>(num_windows()) * num_bodies);
    loaded_ = -1;
  }

  int num_windows() const { return (num_steps_ + length_ - 1) / length_; }
  int begin(int window) const { return window * length_; }
  int end(int window) const { return std::min(num_steps_, (window + 1) * length_); }
  // Returns the window in which step k begins; the last window for the final state.
  int WindowOf(int k) const { return std::min(k / length_, num_windows() - 1); }

  std::span<State> Checkpoint(int window) {
    return {checkpoints_.data() + static_cast<std::size_t>(window) * num_bodies_, size()};
  }

  // Makes `window` the one that is held, with nothing but its first state. Unless it will be `whole`, only some of its
  // states will follow, the last among them.
  void Open(int window, bool whole) {
    loaded_ = window;
    whole_ = whole;
    std::ranges::copy(Checkpoint(window), window_.begin());
  }
  // Ends a window: its last state becomes the checkpoint of the next one.
  void Close() {
    if (loaded_ + 1 < num_windows()) std::ranges::copy(StateAt(end(loaded_)), Checkpoint(loaded_ + 1).begin());
  }
  bool Holds(int window) const { return loaded_ == window && whole_; }
  bool HoldsEnd() const { return loaded_ == num_windows() - 1; }

  // Returns state k of the window that is held, its last state included.
  std::span<State> StateAt(int k) {
    return {window_.data() + static_cast<std::size_t>(k - begin(loaded_)) * num_bodies_, size()};
  }

  std::size_t bytes() const { return (window_.size() + checkpoints_.size()) * sizeof(State); }

 private:
  std::size_t size() const { return static_cast<std::size_t>(num_bodies_); }

  int num_bodies_ = 0, num_steps_ = 0;
  int length_ = 1;  // of a window, in steps
  int loaded_ = -1;
  bool whole_ = false;
  std::vector<State> window_, checkpoints_;
};

}  // namespace saltus
