// Where recorded functions are not smooth: the numbers on whose sign or integer part they decide.
//
// A comparison, abs, sign or floor of a number that depends on the state or the time makes that number a switch. With a
// side given for each switch, the functions are smooth: a piece.
#pragma once

#include <cstdint>
#include <map>
#include <span>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "hybrid/recorded_functions.h"

namespace saltus {

class RecordedSwitches {
 public:
  // Takes several functions whose inputs [x t ...] are the first inputs of one list, that of the first function.
  RecordedSwitches(const std::vector<const ExpressionGraph*>& functions, int num_states);

  int count() const { return static_cast<int>(switches_.size()); }
  // Whether the integer part of the number decides, in the place of its sign.
  bool IsFloor(int number) const { return switches_[number].is_floor; }
  // Whether the number depends on an input from `first` on.
  bool ReadsInputsFrom(int first, int number) const { return last_input_[switches_[number].node] >= first; }
  // The number as a formula in the names of the inputs.
  std::string TextOf(int number, std::span<const std::string> inputs) const {
    return TextOfNode(switches_[number].node, inputs);
  }

  // The side of each switch: the sign of its number (-1, 0 or 1), kSliding where the motion goes along its zeros, or
  // its integer part; kIrrelevant where no function depends on it in this piece.
  using Sides = std::vector<int>;
  static constexpr int kIrrelevant = -(1 << 30), kSliding = 2;
  bool Slides(int number, const Sides& sides) const { return sides[number] == kSliding && !IsFloor(number); }
  // The sides at these inputs, but of those that are not irrelevant in `known`, which may be empty. Returns an empty
  // list if a switch has one side below, and another one above the zero of a number along which the motion slides.
  Sides SidesAt(std::span<const double> inputs, Sides known) const;

  // The sides beside a piece, with another side of one switch: the sides of numbers that jump with it become
  // irrelevant, for SidesAt to find. Integer parts, and what is computed from them, are such numbers.
  Sides WithSide(std::span<const double> inputs, Sides sides, int number, int side) const;

  // A function in a piece. Its inputs are followed by the integer parts, of all switches that have one. `used`: the
  // switches on whose sides it depends; it is the same function wherever these have the same sides.
  // Precondition: the function does not depend on a switch along which the motion slides.
  ExpressionGraph Function(int function, const Sides& sides, std::vector<int>* used) const;
  // Whether no function but the first, and no number of a switch, depends on a switch along which the motion slides.
  bool OnlyFirstFunctionJumps(const Sides& sides) const;
  // Returns the first function below zero of all of k numbers and above zero of each one alone, and the numbers.
  ExpressionGraph CornerFunctions(const Sides& sides) const;
  // Returns the mixed second differences of the first function at these numbers, two at a time.
  ExpressionGraph MixedChanges(const Sides& sides) const;
  // A number that is above zero within the piece and falls through zero where the piece ends: for the integer part
  // below (by = -1) or above (by = 1), or where the sign changes. On a sign of zero it is the number itself.
  ExpressionGraph Guard(int number, int by, const Sides& sides, std::vector<int>* used) const;
  // Whether some conditions are on parameters and the control alone, which no motion changes.
  bool HasFixedConditions() const { return !fixed_.empty(); }
  // Returns the numbers of such conditions that are zero, but for rounding, or integers of which they take the integer
  // part.
  std::vector<std::string> UndecidedAt(std::span<const double> inputs, Sides sides,
                                       std::span<const std::string> names) const;
  // The integer parts, as inputs of functions.
  std::vector<double> Floors(const Sides& sides) const;

 private:
  struct Switch {
    int node;
    bool is_floor;
  };
  using Node = ExpressionGraph::Node;
  int Add(const Node& node);
  int SwitchOf(int node, bool is_floor);
  // Returns the switch of a number, and the sign with which this has that of the switch.
  std::pair<int, int> SignOf(int node, int sign);
  // Returns the switch of a comparison of a and b, whose number times *sign is b - a.
  int Compare(int a, int b, int* sign);
  bool IsZero(int node) const { return nodes_[node].operation == Operation::kConstant && nodes_[node].value == 0; }
  // A number with which inputs of functions begin that are integer parts.
  int FloorInput(int number) const;
  std::vector<int> Sliding(const Sides& sides) const;
  // The sides above zero of some of the numbers along which the motion slides, and below zero of the others.
  Sides Corner(Sides sides, std::span<const int> above) const;
  std::vector<double> ValuesOf(std::span<const double> inputs, Sides* known) const;
  Sides RelevantSides(std::span<const double> inputs, Sides known) const;

  std::string TextOfNode(int number, std::span<const std::string> inputs) const;

  // A graph of nodes of a piece: those that its outputs need.
  class Piece;

  std::vector<Node> nodes_;  // of all functions; equal ones are one
  std::map<std::tuple<Operation, int, int, int, std::uint64_t>, int> known_;
  std::vector<int> last_input_;               // that a node depends on; -1: none
  std::vector<char> moves_;                   // whether it depends on the state or the time
  std::vector<std::pair<int, int>> of_node_;  // switch and sign of a node that decides; -1: none
  std::vector<Switch> switches_, fixed_;      // that a motion changes, and those that it does not
  std::map<std::pair<int, bool>, int> known_switches_;
  std::vector<std::vector<int>> outputs_;  // of each function
  int num_inputs_, num_states_;
};

}  // namespace saltus
