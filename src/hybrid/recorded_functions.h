// Hybrid systems and costs whose functions were recorded once as expression graphs, by a language that is not C++.
//
// A recording is a list of operations, each on the results of earlier ones. It is differentiated symbolically, with
// common subexpressions shared and zeros left out, so that a Jacobian costs its entries that are not always zero; value
// and derivatives are then evaluated by one pass over a flat list of operations.
#pragma once

#include <ceres/cost_function.h>

#include <array>
#include <atomic>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <tuple>
#include <utility>
#include <vector>

#include "saltus/internal/hybrid_functions.h"
#include "saltus/internal/linear_flow.h"

namespace saltus {

enum class Operation : std::uint8_t {
  kConstant,
  kInput,
  kAdd,
  kSubtract,
  kMultiply,
  kDivide,
  kPower,
  kAtan2,
  kLess,       // conditions are 1 or 0
  kLessEqual,  //
  kAnd,
  kOr,
  kNot,
  kLarger,  // |a| > |b|, for choices that change no value, as of a pivot: never a switch
  kWhere,   // the second operand if the first is not 0, otherwise the third
  kNegate,
  kAbs,
  kSign,
  kFloor,
  kSqrt,
  kExp,
  kExpm1,
  kLog,
  kLog1p,
  kSin,
  kCos,
  kTan,
  kAsin,
  kAcos,
  kAtan,
  kSinh,
  kCosh,
  kTanh,
  kAsinh,
  kAcosh,
  kAtanh,
  kErf,
  kProductTerm,  // a b, in the derivative c d + a b of a product a d: 0 if a is 0, c is finite, and b does not exist
};

// The operation's value on numbers; constants and inputs have none.
double Apply(Operation operation, double a, double b, double c);
// Bounds of the operation's value, given those of its operands, but for rounding.
Bounds ApplyToBounds(Operation operation, Bounds a, Bounds b, Bounds c);
std::string_view NameOf(Operation operation);
// The operation of a name in lower case without "k" ("add", "less_equal" ...); false if there is none.
bool FindOperation(std::string_view name, Operation* operation);
// Returns the number of operands; those that an operation does not have are -1.
int NumOperands(Operation operation);

struct ExpressionGraph {
  struct Node {
    Operation operation = Operation::kConstant;
    int a = -1, b = -1, c = -1;  // nodes before this one; a: the number of an input
    double value = 0;            // of a constant
  };
  int num_inputs = 0;
  std::vector<Node> nodes = {};
  std::vector<int> outputs = {};  // nodes
};

// Checks a graph: "found x, expected y", empty if it is valid.
std::string Validate(const ExpressionGraph& graph);

// The flow along the zeros of k numbers, by Filippov's convention: the combination of the flows beside them, in which
// each number keeps its value. `beside`: functions of [x t ...] with n states, those of RecordedSwitches::Beside. Its
// outputs: the flow, and for each number the weight of the flow above zero and that of the flow below; they are above
// zero while the motion slides.
ExpressionGraph FlowAlong(const ExpressionGraph& beside, int n, int k);

// Returns the derivatives of the first output by the first n inputs.
ExpressionGraph GradientOf(const ExpressionGraph& graph, int n);

// Returns the derivatives of the outputs by the first `columns` inputs, where they are not zero, if the function is
// affine in these inputs with coefficients that are numbers; otherwise nothing.
std::optional<std::vector<LinearFlow::Entry>> AffineDerivatives(const ExpressionGraph& graph, int columns);

class RecordedFunction {
 public:
  // Precondition: Validate(recording) is empty.
  explicit RecordedFunction(const ExpressionGraph& graph);

  int num_inputs() const { return num_inputs_; }
  int num_outputs() const { return num_outputs_; }
  const ExpressionGraph& recording() const { return recording_; }

  // The inputs, in parts that follow each other.
  struct Part {
    const double* data;
    int size;
  };
  void Evaluate(std::span<const Part> inputs, double* outputs) const;
  // Sets bounds of the outputs, given those of the inputs, of which there may be more.
  void Bound(std::span<const Bounds> inputs, Bounds* outputs) const;
  // Returns bounds of the derivative by time of the first output, given bounds of the inputs [x t ...] and of x'.
  Bounds BoundRate(std::span<const Bounds> inputs, std::span<const Bounds> slopes) const;
  // Whether it has an exponential, a quotient or what behaves so: it may change within any time and be flat beside it.
  // Other functions have tails that steps see.
  bool MayHideChanges() const;
  // Whether it decides by conditions, abs, sign or floor, so that it may have kinks or jumps.
  bool MayBreak() const { return may_break_; }
  // Computes the outputs and their derivatives by the inputs: row-major, of the first `columns` inputs.
  void Linearize(std::span<const Part> inputs, int columns, double* outputs, double* jacobian) const;
  // Linearizes with the parts of a cost function: any of `jacobians` may be null.
  void Linearize(std::span<const Part> inputs, double* outputs, double** jacobians) const;

  class Evaluation;

 private:
  friend class RecordedMechanics;
  friend class RecordedSystem;
  friend ExpressionGraph FlowAlong(const ExpressionGraph& beside, int n, int k);
  friend ExpressionGraph GradientOf(const ExpressionGraph& graph, int n);
  // A flat list of operations on slots: those of the inputs first, then constants, then results.
  struct Tape {
    // Returns bounds of all slots, given those of the inputs.
    std::vector<Bounds> BoundSlots(std::span<const Bounds> inputs) const;
    struct Instruction {
      Operation operation;
      int a, b, c;  // slots
    };
    std::size_t size = 0;                       // slots
    std::optional<std::vector<int>> few_reads;  // the inputs that it reads, if these are few of many
    std::vector<double> constants;
    std::vector<Instruction> instructions;
    std::vector<int> outputs;  // slots
    // The derivatives of the outputs by the inputs, where these are not always zero.
    struct Entry {
      int row, column, slot;
    };
    std::vector<Entry> entries;
  };
  class Builder;

  ExpressionGraph recording_;
  int num_inputs_ = 0, num_outputs_ = 0;
  bool may_break_ = false;
  Tape values_, derivatives_;
};

class LinearParts;
class RecordedSwitches;

// Inputs: of a flow [x t p u], of a closed form of it [x t p u s], of a guard [x t p] or [x t p u], of a reset [x t p].
//
// A flow that is affine with constant coefficients has a closed form (LinearFlow), which is used if none is recorded.
//
// A mode whose flow or guards decide by numbers that depend on the state or the time (RecordedSwitches) is evaluated as
// it is recorded. A motion goes through its pieces instead, which are modes of their own: they are created as the
// motion meets them, and their last guards are the switches.
class RecordedSystem final : public HybridFunctions {
 public:
  struct Transition {
    RecordedFunction guard, reset;
    int next_mode = 0;
    int accumulation_mode = -1;  // OnAccumulation
  };
  struct Mode {
    RecordedFunction flow;
    std::vector<Transition> transitions;  // of each guard
    std::optional<RecordedFunction> fly = {};
  };
  // Preconditions: sizes are those of the layout. `slides`: a motion that both sides of a switch drive towards it goes
  // on along it, by Filippov's convention.
  RecordedSystem(HybridLayout layout, std::vector<Mode> modes, bool slides = false);
  ~RecordedSystem() override;

  int num_modes() const override { return num_modes_.load(std::memory_order_acquire); }
  int state_size(int mode) const override { return size(mode); }
  int num_guards(int mode) const override { return static_cast<int>(at(mode).guards.size()); }
  int most_guards() const override { return most_guards_; }
  std::string ModeName(int mode) const override { return HybridFunctions::ModeName(at(mode).base); }
  std::string GuardName(int mode, int guard) const override;
  std::string StateName(int mode, int component) const override {
    return HybridFunctions::StateName(at(mode).base, component);
  }
  bool ReadsControl(int mode, int guard) const override;
  int num_switches(int mode) const override { return static_cast<int>(at(mode).switches.size()); }
  int BaseMode(int mode) const override { return at(mode).base; }
  int num_base_modes() const override { return static_cast<int>(modes_.size()); }
  int PieceAt(const ModePoint& point) const override;
  int AdjacentPiece(const ModePoint& point, int guard, Side side) const override;
  bool IsOn(int mode, int guard) const override;
  std::vector<std::string> UndecidedConditions(const ModePoint& point) const override;
  bool ResetMayBreak(int mode, int guard) const override {
    return !IsSwitch(mode, guard) && transition(mode, guard).reset.MayBreak();
  }

  void Flow(const ModePoint& at, double* xdot) const override;
  void FlowJacobian(const ModePoint& at, double* xdot, double* jacobian) const override;
  void Step(const FlowStep& step, const double* slope, double* scratch, double* after,
            double* slope_after) const override;
  bool PullBackStep(const FlowStep& step, const double* after, StepCotangent* out) const override;
  bool Fly(const FlowStep& step, double* after, double* jacobian) const override;
  bool IsLinear(int mode) const override { return at(mode).linear != nullptr; }
  std::vector<StatePart> Parts(int mode) const override;
  void MovePart(int part, const FlowStep& step, double* after, double* jacobian) const override;
  std::vector<int> PartsOf(int mode, int guard) const override;
  double Guard(const ModePoint& at, int guard) const override;
  double GuardRate(const ModePoint& at, int guard, const double* xdot, double* rate) const override;
  double GuardGradient(const ModePoint& at, int guard, double* gradient) const override;
  void AppendGuardTerms(const ModePoint& at, int guard, std::vector<GuardTerm>* terms) const override;
  void Bound(const ModeBox& box, Bounds* slopes, Bounds* guards) const override;
  bool HasBounds() const override { return true; }
  Bounds BoundGuardRate(const ModeBox& box, int guard, const Bounds* slopes) const override;
  bool MayHideChanges(int mode) const override { return at(mode).may_hide_changes; }
  int OnAccumulation(int mode, int guard) const override {
    return IsSwitch(mode, guard) ? -1 : transition(mode, guard).accumulation_mode;
  }
  int Reset(const ModePoint& at, int guard, double* x_plus) const override;
  int ResetJacobian(const ModePoint& at, int guard, double* x_plus, double* jacobian) const override;

 private:
  // A switch of a piece, and where the piece ends by it: RecordedSwitches::Guard, or a weight of FlowAlong.
  struct End {
    int number, by;
    bool slides;
  };
  // A function of pieces that have these sides of the switches on which it depends; any integer parts.
  struct Shared {
    std::vector<std::pair<int, int>> sides;
    RecordedFunction function;
    std::optional<LinearFlow> linear;
  };
  // A mode as it is recorded, or a piece of one.
  struct Evaluated {
    int base, size;  // the mode as it is recorded, and its number of states
    const RecordedFunction* flow;
    std::vector<const RecordedFunction*> guards;
    const RecordedFunction* fly;
    const LinearFlow* linear;
    std::vector<int> sides;
    std::vector<End> switches;  // the last guards
    std::vector<double> floors;
    bool may_hide_changes = false;
  };

  // Modes do not move: the first of all blocks has one, each further one twice as many as the one before.
  const Evaluated& at(int mode) const {
    const auto number = static_cast<unsigned>(mode) + 1;
    const int block = std::bit_width(number) - 1;
    return blocks_[block].load(std::memory_order_acquire)[number - (1u << block)];
  }
  int Keep(Evaluated mode) const;
  int PieceOf(int base, std::vector<int> sides) const;
  // Returns the function with this key in a piece of these sides, which `make(&used)` makes if none is known.
  template <typename Make>
  const Shared& SharedBy(std::tuple<int, int, int> key, const std::vector<int>& sides, const Make& make) const;
  int PieceAlong(const ModePoint& point, int guard) const;
  bool PointsAt(const ModePoint& point, int number) const;
  std::vector<double> SwitchInputsAt(const ModePoint& point) const;
  std::vector<std::string> SwitchInputNames(int mode) const;
  std::vector<int> SidesAt(const ModePoint& point, std::vector<int> known) const;

  int size(int mode) const { return at(mode).size; }
  int num_parameters() const { return layout().num_parameters; }
  int num_columns(int mode) const { return size(mode) + 1 + num_parameters() + layout().num_controls; }
  const Transition& transition(int mode, int guard) const { return modes_[at(mode).base].transitions[guard]; }
  using Inputs = std::array<RecordedFunction::Part, 5>;  // of a flow, and the integer parts of a piece
  // The inputs point into the point, which has to outlive them.
  Inputs InputsAt(const ModePoint& at) const;
  Inputs InputsAt(ModePoint&& at) const = delete;
  std::vector<Bounds> InputsIn(const ModeBox& box) const;
  // The inputs of a guard or a reset: without control, unless it reads it or is one of a piece.
  std::span<const RecordedFunction::Part> InputsOf(const RecordedFunction& function, const Inputs& inputs) const;

  // Returns the value of a guard, and calls visit(column, derivative) for each derivative that is not always zero.
  template <typename Visit>
  double LinearizeGuard(const ModePoint& at, int guard, const Visit& visit) const;
  std::optional<LinearFlow> LinearFlowOf(int base, const RecordedFunction& flow) const;

  const std::vector<Mode> modes_;
  std::vector<std::optional<LinearFlow>> linear_;  // of each mode, as it is recorded
  const bool slides_;
  std::vector<std::unique_ptr<const RecordedSwitches>> conditions_;  // of each mode
  std::vector<const RecordedSwitches*> switches_;                    // these, of each mode; null: it has no switches
  std::vector<std::unique_ptr<const LinearParts>> parts_;            // of each mode; null: it has one
  int most_guards_ = 0;
  std::vector<double> no_control_;  // zeros
  static constexpr int kBlocks = 24;
  mutable std::array<std::atomic<Evaluated*>, kBlocks> blocks_{};
  mutable std::atomic<int> num_modes_ = 0;
  mutable std::mutex mutex_;                                       // while modes are created
  mutable std::map<std::pair<int, std::vector<int>>, int> known_;  // under mutex_: pieces
  // Functions of pieces, by base mode and number, or switch and direction; under mutex_; the elements do not move.
  mutable std::map<std::tuple<int, int, int>, std::deque<Shared>> shared_;
};

// Residuals of the given blocks.
class RecordedCost final : public ceres::CostFunction {
 public:
  // Preconditions: the sizes of the blocks, at most kMostBlocks, add up to the number of inputs.
  RecordedCost(RecordedFunction function, const std::vector<int>& block_sizes);
  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override;
  // Returns the numbers that decide about the residuals and are zero at these blocks, as formulas in the names of what
  // it reads.
  std::vector<std::string> UndecidedAt(const std::vector<const double*>& blocks,
                                       std::span<const std::string> names) const;

 private:
  static constexpr std::size_t kMostBlocks = 8;
  const RecordedFunction function_;
  std::shared_ptr<const RecordedSwitches> conditions_;  // null: it has none
};

}  // namespace saltus
