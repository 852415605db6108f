#include "hybrid/recorded_switches.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <functional>

#include "base/number_text.h"

namespace saltus {

RecordedSwitches::RecordedSwitches(const std::vector<const ExpressionGraph*>& functions, int num_states)
    : num_inputs_(0), num_states_(num_states) {
  for (const ExpressionGraph* function : functions) {
    num_inputs_ = std::max(num_inputs_, function->num_inputs);
    std::vector<int> of_node;
    for (Node node : function->nodes) {
      if (node.operation != Operation::kInput) {
        for (int* operand : {&node.a, &node.b, &node.c}) {
          if (*operand >= 0) *operand = of_node[*operand];
        }
      }
      of_node.push_back(Add(node));
    }
    std::vector<int>& outputs = outputs_.emplace_back();
    for (const int output : function->outputs) outputs.push_back(of_node[output]);
  }
}

// Adds a node with its switch; returns the number of an equal one if there is one.
int RecordedSwitches::Add(const Node& node) {
  const auto key = std::tuple(node.operation, node.a, node.b, node.c, std::bit_cast<std::uint64_t>(node.value));
  if (const auto known = known_.find(key); known != known_.end()) return known->second;
  using enum Operation;
  int last = node.operation == kInput ? node.a : -1;
  bool moves = node.operation == kInput && node.a <= num_states_;
  for (int i = 0; i < NumOperands(node.operation); ++i) {
    const int operand = std::array{node.a, node.b, node.c}[i];
    last = std::max(last, last_input_[operand]);
    moves = moves || moves_[operand];
  }
  std::pair<int, int> decides{-1, 0};
  if (moves && (node.operation == kLess || node.operation == kLessEqual)) {
    int sign = 1;
    const int number = Compare(node.a, node.b, &sign);
    decides = SignOf(number, sign);
  } else if (moves && node.operation == kFloor) {
    decides = {SwitchOf(node.a, true), 1};
  } else if (moves && (node.operation == kAbs || node.operation == kSign)) {
    decides = SignOf(node.a, 1);
  }
  if (!moves && last >= 0) {
    int sign = 0;
    const bool compares = node.operation == kLess || node.operation == kLessEqual;
    if (compares || node.operation == kFloor || node.operation == kAbs || node.operation == kSign)
      fixed_.push_back({compares ? Compare(node.a, node.b, &sign) : node.a, node.operation == kFloor});
  }
  const int index = static_cast<int>(nodes_.size());
  nodes_.push_back(node);
  last_input_.push_back(last);
  moves_.push_back(moves);
  of_node_.push_back(decides);
  return known_[key] = index;
}

int RecordedSwitches::SwitchOf(int node, bool is_floor) {
  const auto [known, is_new] = known_switches_.try_emplace({node, is_floor}, count());
  if (is_new) switches_.push_back({node, is_floor});
  return known->second;
}

// Multiples, odd powers and the like of one number have its sign and zeros.
std::pair<int, int> RecordedSwitches::SignOf(int number, int sign) {
  using enum Operation;
  for (;;) {
    const Node& node = nodes_[number];
    const auto constant = [&](int operand) {
      return operand >= 0 && nodes_[operand].operation == kConstant ? nodes_[operand].value : 0.0;
    };
    const double a = constant(node.a), b = constant(node.b);
    int inner = -1;
    if (node.operation == kNegate) {
      inner = node.a;
      sign = -sign;
    } else if ((node.operation == kMultiply || node.operation == kDivide) && b != 0 && std::isfinite(b)) {
      inner = node.a;
      sign = b > 0 ? sign : -sign;
    } else if (node.operation == kMultiply && a != 0 && std::isfinite(a)) {
      inner = node.b;
      sign = a > 0 ? sign : -sign;
    } else if (node.operation == kPower && b > 0 && std::fmod(b, 2) == 1) {
      inner = node.a;
    } else if (node.operation == kSinh || node.operation == kTanh || node.operation == kAsinh ||
               node.operation == kAtan || node.operation == kErf) {
      inner = node.a;
    }
    if (inner < 0) return {SwitchOf(number, false), sign};
    number = inner;
  }
}

int RecordedSwitches::Compare(int a, int b, int* sign) {
  *sign = 1;
  if (IsZero(a)) return b;
  const bool swaps = IsZero(b) || nodes_[b].operation == Operation::kConstant ||
                     (nodes_[a].operation != Operation::kConstant && a < b);
  if (swaps) {
    std::swap(a, b);
    *sign = -1;
  }
  return IsZero(a) ? b : Add({Operation::kSubtract, b, a, -1, 0});
}

int RecordedSwitches::FloorInput(int number) const {
  return num_inputs_ +
         static_cast<int>(std::count_if(
             switches_.begin(), switches_.begin() + number, [](const Switch& other) { return other.is_floor; }));
}

std::vector<double> RecordedSwitches::Floors(const Sides& sides) const {
  std::vector<double> floors;
  for (int i = 0; i < count(); ++i) {
    if (IsFloor(i)) floors.push_back(sides[i] == kIrrelevant ? 0 : sides[i]);
  }
  return floors;
}

// With sides given, comparisons have a constant value, and what they do not choose is not needed.
class RecordedSwitches::Piece {
 public:
  Piece(const RecordedSwitches& all, const Sides& sides)
      : all_(all), sides_(sides), to_(all.nodes_.size(), -1), truth_(to_), is_used_(all.count()) {}

  int Needed(int node) {
    if (to_[node] >= 0) return to_[node];
    const Node& from = all_.nodes_[node];
    using enum Operation;
    const int truth = Truth(node);
    if (truth != kUnknown) return to_[node] = Constant(truth);
    switch (from.operation) {
      case kConstant:
      case kInput:
        return to_[node] = Push(from);
      case kWhere:
        if (const int chosen = Truth(from.a); chosen != kUnknown) {
          return to_[node] = Needed(chosen != 0 ? from.b : from.c);
        }
        break;
      default:
        break;
    }
    if (const auto [number, sign] = all_.of_node_[node]; number >= 0) {
      Use(number);
      const int side = sides_[number];
      if (from.operation == kFloor) return to_[node] = Push({kInput, all_.FloorInput(number), -1, -1, 0});
      if (from.operation == kSign || side == 0) return to_[node] = Constant(sign * side);
      const int inner = Needed(from.a);  // of abs
      return to_[node] = sign * side > 0 ? inner : Push({kNegate, inner, -1, -1, 0});
    }
    // A root or a power of a number that is not negative has no values beyond the piece.
    if (from.operation == kSqrt || (from.operation == kPower && !IsWhole(from.b))) {
      const Node& base = all_.nodes_[from.a];
      if (base.operation == kAbs && all_.of_node_[from.a].first >= 0) {
        Use(all_.of_node_[from.a].first);
        const int inner = Push({kAbs, Needed(base.a), -1, -1, 0});
        return to_[node] = Push({from.operation, inner, from.b < 0 ? -1 : Needed(from.b), -1, 0});
      }
    }
    Node copy = from;
    const int operands = NumOperands(from.operation);
    if (operands > 0) copy.a = Needed(from.a);
    if (operands > 1) copy.b = Needed(from.b);
    if (operands > 2) copy.c = Needed(from.c);
    return to_[node] = Push(copy);
  }
  int Push(const Node& node) {
    graph.nodes.push_back(node);
    return static_cast<int>(graph.nodes.size()) - 1;
  }
  int Constant(double value) { return Push({Operation::kConstant, -1, -1, -1, value}); }

  ExpressionGraph graph;
  std::vector<int> used;  // switches

 private:
  static constexpr int kUnknown = -1;

  bool IsWhole(int node) const {
    const Node& exponent = all_.nodes_[node];
    return exponent.operation == Operation::kConstant && exponent.value == std::round(exponent.value);
  }

  void Use(int number) {
    if (!is_used_[number]) used.push_back(number);
    is_used_[number] = true;
  }

  // Returns the value of a condition, 0 or 1, if the sides determine it.
  int Truth(int node) {
    int& truth = truth_[node];
    if (truth != kUnknown) return truth;
    const Node& from = all_.nodes_[node];
    using enum Operation;
    if (from.operation == kLess || from.operation == kLessEqual) {
      const auto [number, sign] = all_.of_node_[node];
      if (number < 0) return kUnknown;
      Use(number);
      const int side = sign * sides_[number];
      return truth = from.operation == kLess ? side > 0 : side >= 0;
    }
    if (from.operation == kNot) {
      const int inner = Truth(from.a);
      return truth = inner == kUnknown ? kUnknown : 1 - inner;
    }
    if (from.operation != kAnd && from.operation != kOr) return kUnknown;
    const int decides = from.operation == kOr;
    const int a = Truth(from.a);
    if (a == decides) return truth = decides;
    const int b = Truth(from.b);
    if (b == decides) return truth = decides;
    return truth = a == kUnknown || b == kUnknown ? kUnknown : 1 - decides;
  }

  const RecordedSwitches& all_;
  const Sides& sides_;
  std::vector<int> to_, truth_;
  std::vector<bool> is_used_;
};

std::vector<int> RecordedSwitches::Sliding(const Sides& sides) const {
  std::vector<int> sliding;
  for (int number = 0; number < count(); ++number) {
    if (Slides(number, sides)) sliding.push_back(number);
  }
  return sliding;
}

RecordedSwitches::Sides RecordedSwitches::Corner(Sides sides, std::span<const int> above) const {
  for (const int number : Sliding(sides)) sides[number] = -1;
  for (const int number : above) sides[number] = 1;
  return sides;
}

RecordedSwitches::Sides RecordedSwitches::SidesAt(std::span<const double> inputs, Sides known) const {
  known.resize(count(), kIrrelevant);
  const std::vector<int> sliding = Sliding(known);
  Sides sides = RelevantSides(inputs, Corner(known, {}));
  for (const int above : sliding) {
    const Sides beside = RelevantSides(inputs, Corner(known, {&above, 1}));
    for (int number = 0; number < count(); ++number) {
      if (beside[number] == kIrrelevant) continue;
      if (sides[number] != kIrrelevant && sides[number] != beside[number] && !Slides(number, known)) return {};
      sides[number] = beside[number];
    }
  }
  for (const int number : sliding) {
    if (sides[number] != kIrrelevant) sides[number] = kSliding;
  }
  return sides;
}

// Returns the values of all nodes, in one pass in their order: a switch that is not known gets its side where its
// number is.
std::vector<double> RecordedSwitches::ValuesOf(std::span<const double> inputs, Sides* known) const {
  std::vector<double> values(nodes_.size());
  for (std::size_t i = 0; i < nodes_.size(); ++i) {
    const Node& node = nodes_[i];
    using enum Operation;
    const auto at = [&](int operand) { return operand < 0 ? 0 : values[operand]; };
    if (node.operation == kConstant || node.operation == kInput) {
      values[i] = node.operation == kConstant ? node.value : inputs[node.a];
      continue;
    }
    const auto [number, sign] = of_node_[i];
    if (number < 0) {
      values[i] = Apply(node.operation, at(node.a), at(node.b), at(node.c));
      continue;
    }
    int& side = (*known)[number];
    if (side == kIrrelevant) {
      const double value = values[switches_[number].node];
      if (IsFloor(number)) {
        side = std::isfinite(value) ? static_cast<int>(std::clamp(std::floor(value), -1e9, 1e9)) : 0;
      } else {
        side = value > 0 ? 1 : value < 0 ? -1 : 0;
      }
    }
    values[i] = node.operation == kLess        ? sign * side > 0
                : node.operation == kLessEqual ? sign * side >= 0
                : node.operation == kAbs       ? sign * side * at(node.a)
                                               : sign * side;
  }
  return values;
}

std::vector<std::string> RecordedSwitches::UndecidedAt(std::span<const double> inputs, Sides sides,
                                                       std::span<const std::string> names) const {
  constexpr double kRounding = 1e-15;  // of the operands
  const std::vector<double> values = ValuesOf(inputs, &sides);
  std::vector<std::string> texts;
  for (const Switch& fixed : fixed_) {
    const Node& node = nodes_[fixed.node];
    const double value = values[fixed.node];
    double size = std::abs(value);
    if (node.operation == Operation::kAdd || node.operation == Operation::kSubtract)
      size = std::max({size, std::abs(values[node.a]), std::abs(values[node.b])});
    const double off = fixed.is_floor ? value - std::round(value) : value;
    if (!(std::abs(off) <= kRounding * size)) continue;
    std::string text = TextOfNode(fixed.node, names);
    if (std::ranges::find(texts, text) == texts.end()) texts.push_back(std::move(text));
  }
  return texts;
}

RecordedSwitches::Sides RecordedSwitches::WithSide(std::span<const double> inputs, Sides sides, int number,
                                                   int side) const {
  constexpr double kSame = 1e-9;  // relative: values of a number that does not jump
  Sides all = sides;
  const std::vector<double> before = ValuesOf(inputs, &all);
  sides[number] = side;
  for (bool jumps = true; jumps;) {
    jumps = false;
    all = sides;
    const std::vector<double> after = ValuesOf(inputs, &all);
    for (int other = 0; other < count(); ++other) {
      const double from = before[switches_[other].node], to = after[switches_[other].node];
      if (other == number || sides[other] == kIrrelevant ||
          std::abs(to - from) <= kSame * (std::abs(to) + std::abs(from)))
        continue;
      sides[other] = kIrrelevant;
      jumps = true;
    }
  }
  return sides;
}

RecordedSwitches::Sides RecordedSwitches::RelevantSides(std::span<const double> inputs, Sides known) const {
  ValuesOf(inputs, &known);
  // Collects the switches on which the functions depend, and on which the numbers of these switches depend.
  Piece piece(*this, known);
  for (const std::vector<int>& outputs : outputs_) {
    for (const int output : outputs) piece.Needed(output);
  }
  for (std::size_t i = 0; i < piece.used.size(); ++i) piece.Needed(switches_[piece.used[i]].node);
  Sides sides(count(), kIrrelevant);
  for (const int number : piece.used) sides[number] = known[number];
  return sides;
}

bool RecordedSwitches::OnlyFirstFunctionJumps(const Sides& sides) const {
  const Sides corner = Corner(sides, {});
  Piece piece(*this, corner);
  for (std::size_t function = 1; function < outputs_.size(); ++function) {
    for (const int output : outputs_[function]) piece.Needed(output);
  }
  for (int number = 0; number < count(); ++number) {
    if (sides[number] != kIrrelevant) piece.Needed(switches_[number].node);
  }
  return std::ranges::none_of(piece.used, [&](int number) { return Slides(number, sides); });
}

ExpressionGraph RecordedSwitches::CornerFunctions(const Sides& sides) const {
  ExpressionGraph graph;
  const std::vector<int> sliding = Sliding(sides);
  for (std::size_t i = 0; i <= sliding.size(); ++i) {
    const Sides corner = Corner(sides, std::span(sliding).subspan(i == 0 ? 0 : i - 1, i == 0 ? 0 : 1));
    Piece piece(*this, corner);
    piece.graph = std::move(graph);
    for (const int output : outputs_[0]) {
      const int node = piece.Needed(output);
      piece.graph.outputs.push_back(node);
    }
    if (i == sliding.size()) {
      for (const int number : sliding) {
        const int node = piece.Needed(switches_[number].node);
        piece.graph.outputs.push_back(node);
      }
    }
    graph = std::move(piece.graph);
  }
  graph.num_inputs = FloorInput(count());
  return graph;
}

ExpressionGraph RecordedSwitches::MixedChanges(const Sides& sides) const {
  ExpressionGraph graph;
  const std::vector<int> sliding = Sliding(sides);
  for (std::size_t i = 0; i < sliding.size(); ++i) {
    for (std::size_t j = 0; j < i; ++j) {
      const std::array<std::vector<int>, 4> above = {
          {{sliding[i], sliding[j]}, {sliding[i]}, {}, {sliding[j]}}};  // with alternating signs
      std::vector<int> sums;
      for (std::size_t k = 0; k < above.size(); ++k) {
        const Sides corner = Corner(sides, above[k]);
        Piece piece(*this, corner);
        piece.graph = std::move(graph);
        for (std::size_t row = 0; row < outputs_[0].size(); ++row) {
          const int node = piece.Needed(outputs_[0][row]);
          if (k == 0) {
            sums.push_back(node);
          } else {
            sums[row] = piece.Push({k % 2 == 1 ? Operation::kSubtract : Operation::kAdd, sums[row], node, -1, 0});
          }
        }
        graph = std::move(piece.graph);
      }
      graph.outputs.insert(graph.outputs.end(), sums.begin(), sums.end());
    }
  }
  graph.num_inputs = FloorInput(count());
  return graph;
}

ExpressionGraph RecordedSwitches::Function(int function, const Sides& sides, std::vector<int>* used) const {
  const Sides corner = Corner(sides, {});
  Piece piece(*this, corner);
  for (const int output : outputs_[function]) piece.graph.outputs.push_back(piece.Needed(output));
  piece.graph.num_inputs = FloorInput(count());
  *used = std::move(piece.used);
  return std::move(piece.graph);
}

ExpressionGraph RecordedSwitches::Guard(int number, int by, const Sides& sides, std::vector<int>* used) const {
  using enum Operation;
  const Sides corner = Corner(sides, {});
  Piece piece(*this, corner);
  int output = piece.Needed(switches_[number].node);
  if (IsFloor(number)) {
    const int floor = piece.Push({kInput, FloorInput(number), -1, -1, 0});
    if (by < 0) {
      output = piece.Push({kSubtract, output, floor, -1, 0});
    } else {
      const int next = piece.Push({kAdd, floor, piece.Constant(1), -1, 0});
      output = piece.Push({kSubtract, next, output, -1, 0});
    }
  } else if (sides[number] < 0) {
    output = piece.Push({kNegate, output, -1, -1, 0});
  }
  piece.graph.outputs = {output};
  piece.graph.num_inputs = FloorInput(count());
  *used = std::move(piece.used);
  used->push_back(number);
  return std::move(piece.graph);
}

std::string RecordedSwitches::TextOfNode(int number, std::span<const std::string> inputs) const {
  constexpr int kDeepest = 6;
  const std::function<std::string(int, int)> text_at = [&](int index, int depth) -> std::string {
    if (depth > kDeepest) return "...";
    const Node& node = nodes_[index];
    using enum Operation;
    const auto text = [&](int operand) { return text_at(operand, depth + 1); };
    const auto infix = [&](const char* sign) { return "(" + text(node.a) + sign + text(node.b) + ")"; };
    switch (node.operation) {
      case kConstant:
        return ToText(node.value, 6);
      case kInput:
        return inputs[node.a];
      case kAdd:
        return infix(" + ");
      case kSubtract:
        return infix(" - ");
      case kMultiply:
        return infix(" * ");
      case kDivide:
        return infix(" / ");
      case kPower:
        return infix(" ** ");
      case kNegate:
        return "-" + text(node.a);
      default:
        std::string call = std::string(NameOf(node.operation)) + "(" + text(node.a);
        if (node.b >= 0) call += ", " + text(node.b);
        if (node.c >= 0) call += ", " + text(node.c);
        return call + ")";
    }
  };
  std::string out = text_at(number, 0);
  if (out.size() > 2 && out.front() == '(') out = out.substr(1, out.size() - 2);
  constexpr std::size_t kLongest = 60;
  return out.size() <= kLongest ? out : out.substr(0, kLongest - 3) + "...";
}

}  // namespace saltus
