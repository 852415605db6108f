// The record of a rollout, in the order of time, from which it can be differentiated.
#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "saltus/hybrid/hybrid_simulator.h"

namespace saltus {

struct TapeEntry {
  enum class Kind {
    kToNode,   // a step to a time of the grid, which is a fixed part of the duration; projected, if the mode projects
    kToEvent,  // a step to where a guard is zero
    kReset,
  };
  Kind kind = Kind::kToNode;
  int mode = 0;
  int guard = -1;
  int interval = 0;     // whose control acts
  int node = 0;         // kToNode: number of the time of the grid, of the K n steps
  int event = -1;       // kReset: number of the event
  double t = 0, h = 0;  // begins at t; kReset: h = 0
  std::size_t x = 0;    // where its state begins in MotionTape::numbers
};

// A remark on a place of a motion.
struct TimedRemark {
  std::string what;                 // empty: there is none
  std::optional<double> time = {};  // none: it is of no time
  std::string where = {};           // goes on behind the time

  bool empty() const { return what.empty(); }
};
// Returns the first remarks in one text, which counts the others. Those that differ in time only are told once, with
// the first time and their number.
// Times have six digits, to which the same optimum agrees from machine to machine.
std::string JoinRemarks(const std::vector<TimedRemark>& remarks);

// Events that happen at one time, or where the control jumps: the derivative may differ from side to side.
struct Coincidence {
  std::size_t begin = 0, end = 0;  // entries, from the step to the first event to the last reset
  std::vector<int> guards;         // that are at zero before the first event
  int tie = -1;                    // number of the tie, if there are several
  int jump = -1;                   // control interval that begins there
  TimedRemark remark;              // where the derivative does differ
};

struct MotionTape {
  std::vector<TapeEntry> entries;
  std::vector<double> numbers;         // states, one after the other
  std::vector<std::size_t> intervals;  // the entry with which each control interval begins
  std::vector<Coincidence> coincidences;
  int num_nodes = 0;              // the steps of the grid, K n if no interval is divided
  double step = 0;                // s: of each of K n equal ones
  std::vector<int> begins;        // the node at which each control interval begins
  std::vector<double> fractions;  // times of the grid as parts of the duration; none: of K n equal steps
  int final_mode = 0;
  std::size_t final_state = 0;  // in numbers

  double Fraction(int node) const {
    return fractions.empty() ? static_cast<double>(node) / num_nodes : fractions[node];
  }
  void Clear() {
    entries.clear();
    coincidences.clear();
    begins.clear();
    fractions.clear();
    numbers.clear();
    intervals.clear();
  }
  std::size_t Keep(const double* x, int size) {
    numbers.insert(numbers.end(), x, x + size);
    return numbers.size() - size;
  }
};

}  // namespace saltus
