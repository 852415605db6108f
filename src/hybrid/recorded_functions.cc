#include "hybrid/recorded_functions.h"

#include <glog/logging.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>
#include <numeric>
#include <tuple>
#include <type_traits>
#include <utility>

#include "base/random.h"
#include "hybrid/linear_parts.h"
#include "hybrid/recorded_switches.h"
#include "hybrid/runge_kutta.h"

namespace saltus {
namespace {

// In the order of Operation. `value` is that of the operation on numbers; constants and inputs have none.
struct KnownOperation {
  Operation operation;
  std::string_view name;
  int operands;
  double (*value)(double a, double b, double c);
};

constexpr KnownOperation kOperations[] = {
    {Operation::kConstant, "constant", 0, nullptr},
    {Operation::kInput, "input", 0, nullptr},
    {Operation::kAdd, "add", 2, [](double a, double b, double) { return a + b; }},
    {Operation::kSubtract, "subtract", 2, [](double a, double b, double) { return a - b; }},
    {Operation::kMultiply, "multiply", 2, [](double a, double b, double) { return a * b; }},
    {Operation::kDivide, "divide", 2, [](double a, double b, double) { return a / b; }},
    {Operation::kPower, "power", 2, [](double a, double b, double) { return std::pow(a, b); }},
    {Operation::kAtan2, "atan2", 2, [](double a, double b, double) { return std::atan2(a, b); }},
    {Operation::kLess, "less", 2, [](double a, double b, double) { return double(a < b); }},
    {Operation::kLessEqual, "less_equal", 2, [](double a, double b, double) { return double(a <= b); }},
    {Operation::kAnd, "and", 2, [](double a, double b, double) { return double(a != 0 && b != 0); }},
    {Operation::kOr, "or", 2, [](double a, double b, double) { return double(a != 0 || b != 0); }},
    {Operation::kNot, "not", 1, [](double a, double, double) { return double(a == 0); }},
    {Operation::kLarger, "larger", 2, [](double a, double b, double) { return double(std::abs(a) > std::abs(b)); }},
    {Operation::kWhere, "where", 3, [](double a, double b, double c) { return a != 0 ? b : c; }},
    {Operation::kNegate, "negate", 1, [](double a, double, double) { return -a; }},
    {Operation::kAbs, "abs", 1, [](double a, double, double) { return std::abs(a); }},
    {Operation::kSign, "sign", 1, [](double a, double, double) { return double((a > 0) - (a < 0)); }},
    {Operation::kFloor, "floor", 1, [](double a, double, double) { return std::floor(a); }},
    {Operation::kSqrt, "sqrt", 1, [](double a, double, double) { return std::sqrt(a); }},
    {Operation::kExp, "exp", 1, [](double a, double, double) { return std::exp(a); }},
    {Operation::kExpm1, "expm1", 1, [](double a, double, double) { return std::expm1(a); }},
    {Operation::kLog, "log", 1, [](double a, double, double) { return std::log(a); }},
    {Operation::kLog1p, "log1p", 1, [](double a, double, double) { return std::log1p(a); }},
    {Operation::kSin, "sin", 1, [](double a, double, double) { return std::sin(a); }},
    {Operation::kCos, "cos", 1, [](double a, double, double) { return std::cos(a); }},
    {Operation::kTan, "tan", 1, [](double a, double, double) { return std::tan(a); }},
    {Operation::kAsin, "asin", 1, [](double a, double, double) { return std::asin(a); }},
    {Operation::kAcos, "acos", 1, [](double a, double, double) { return std::acos(a); }},
    {Operation::kAtan, "atan", 1, [](double a, double, double) { return std::atan(a); }},
    {Operation::kSinh, "sinh", 1, [](double a, double, double) { return std::sinh(a); }},
    {Operation::kCosh, "cosh", 1, [](double a, double, double) { return std::cosh(a); }},
    {Operation::kTanh, "tanh", 1, [](double a, double, double) { return std::tanh(a); }},
    {Operation::kAsinh, "asinh", 1, [](double a, double, double) { return std::asinh(a); }},
    {Operation::kAcosh, "acosh", 1, [](double a, double, double) { return std::acosh(a); }},
    {Operation::kAtanh, "atanh", 1, [](double a, double, double) { return std::atanh(a); }},
    {Operation::kErf, "erf", 1, [](double a, double, double) { return std::erf(a); }},
    {Operation::kProductTerm,
     "product_term",
     3,
     [](double a, double b, double c) { return a == 0 && std::isnan(b) && std::isfinite(c) ? 0.0 : a * b; }},
};

constexpr int kMostMultiplications = 4;  // powers up to this are products
constexpr int kFewReads = 8;             // one input in so many at most: only these are copied

// Room for numbers, from the heap if they are many.
class Memory {
 public:
  double* Allocate(std::size_t size) {
    if (size <= kSmall) return small_;
    large_.resize(size);
    return large_.data();
  }

 private:
  static constexpr std::size_t kSmall = 4096;
  double small_[kSmall];  // not initialized
  std::vector<double> large_;
};

}  // namespace

double Apply(Operation operation, double a, double b, double c) {
  return kOperations[static_cast<int>(operation)].value(a, b, c);
}

Bounds ApplyToBounds(Operation operation, Bounds a, Bounds b, Bounds c) {
  using enum Operation;
  constexpr double kInfinity = std::numeric_limits<double>::infinity(), kPi = std::numbers::pi;
  constexpr Bounds kAll{-kInfinity, kInfinity};
  const auto has_zero = [](Bounds of) { return of.low <= 0 && of.high >= 0; };
  // Whether an angle has `angle` plus a whole number of periods.
  const auto has_angle = [](Bounds of, double angle, double period) {
    return angle + period * std::ceil((of.low - angle) / period) <= of.high;
  };
  if (operation == kAdd) return {a.low + b.low, a.high + b.high};
  if (operation == kSubtract) return {a.low - b.high, a.high - b.low};
  if (operation == kMultiply || (operation == kDivide && !has_zero(b))) {
    if (operation == kDivide) b = {1 / b.high, 1 / b.low};
    const double products[] = {a.low * b.low, a.low * b.high, a.high * b.low, a.high * b.high};
    if (std::isnan(products[0] + products[1] + products[2] + products[3])) return kAll;
    return {std::min(std::min(products[0], products[1]), std::min(products[2], products[3])),
            std::max(std::max(products[0], products[1]), std::max(products[2], products[3]))};
  }
  const bool is_whole = b.low == b.high && b.low == std::round(b.low);
  if (operation == kLarger || operation == kAnd || operation == kOr || operation == kNot) return {0, 1};
  if (operation == kWhere) {
    if (!has_zero(a)) return b;
    return a.low == a.high ? c : Bounds{std::min(b.low, c.low), std::max(b.high, c.high)};
  }
  if (operation == kDivide || (operation == kTan && has_angle(a, kPi / 2, kPi)) ||
      (operation == kPower && !(is_whole ? b.low > 0 || !has_zero(a) : a.low > 0 || (a.low == 0 && b.low > 0)))) {
    return kAll;
  }
  if (operation == kAtan2 && has_zero(a) && !(b.low > 0)) return {-kPi, kPi};
  // The rest is monotone in each operand, but for crests.
  Bounds bounds{kInfinity, -kInfinity};
  const auto add = [&](double value) {
    bounds = std::isnan(value) ? kAll : Bounds{std::min(bounds.low, value), std::max(bounds.high, value)};
  };
  const int operands = NumOperands(operation);
  for (const double of_a : {a.low, a.high}) {
    add(Apply(operation, of_a, b.low, c.low));
    if (operands > 1) add(Apply(operation, of_a, b.high, c.low));
  }
  const bool is_even =
      operation == kAbs || operation == kCosh || (operation == kPower && is_whole && std::fmod(b.low, 2) == 0);
  if (is_even && has_zero(a)) add(Apply(operation, 0, b.low, 0));
  const double crest = operation == kSin ? kPi / 2 : 0;
  if (operation == kSin || operation == kCos) {
    if (has_angle(a, crest, 2 * kPi)) add(1);
    if (has_angle(a, crest + kPi, 2 * kPi)) add(-1);
  }
  return bounds;
}

std::string_view NameOf(Operation operation) { return kOperations[static_cast<int>(operation)].name; }

bool FindOperation(std::string_view name, Operation* operation) {
  for (const KnownOperation& known : kOperations) {
    if (known.name != name) continue;
    *operation = known.operation;
    return true;
  }
  return false;
}

int NumOperands(Operation operation) { return kOperations[static_cast<int>(operation)].operands; }

std::string Validate(const ExpressionGraph& recording) {
  const int count = static_cast<int>(recording.nodes.size());
  for (int i = 0; i < count; ++i) {
    const ExpressionGraph::Node& node = recording.nodes[i];
    if (node.operation == Operation::kInput) {
      if (node.a >= 0 && node.a < recording.num_inputs) continue;
      return "found input " + std::to_string(node.a) + ", expected 0 to " + std::to_string(recording.num_inputs - 1);
    }
    const std::array<int, 3> operands = {node.a, node.b, node.c};
    for (int j = 0; j < NumOperands(node.operation); ++j) {
      if (operands[j] >= 0 && operands[j] < i) continue;
      return "node " + std::to_string(i) + ": found operand " + std::to_string(operands[j]) +
             ", expected a node before it";
    }
  }
  for (const int output : recording.outputs) {
    if (output < 0 || output >= count) {
      return "found output " + std::to_string(output) + ", expected a node from 0 to " + std::to_string(count - 1);
    }
  }
  return "";
}

std::optional<std::vector<LinearFlow::Entry>> AffineDerivatives(const ExpressionGraph& graph, int columns) {
  using enum Operation;
  struct Form {
    bool is_affine = true;
    std::optional<double> number = {};  // of a value that depends on no input
    std::map<int, double> by = {};      // inputs
  };
  std::vector<Form> forms;
  const auto sum = [](const Form& a, double factor, const Form& b) {
    Form form{a.is_affine && b.is_affine, std::nullopt, a.by};
    for (const auto& [input, by] : b.by) form.by[input] += factor * by;
    return form;
  };
  const auto scaled = [](const Form& a, double factor) {
    Form form{a.is_affine && std::isfinite(factor), std::nullopt, a.by};
    for (auto& [input, by] : form.by) by *= factor;
    return form;
  };
  const auto is = [](const Form& a, double number) { return a.number && *a.number == number; };
  for (const ExpressionGraph::Node& node : graph.nodes) {
    if (node.operation == kConstant || node.operation == kInput) {
      const bool counts = node.operation == kInput && node.a < columns;
      forms.push_back({});
      if (node.operation == kConstant) forms.back().number = node.value;
      if (counts) forms.back().by[node.a] = 1;
      continue;
    }
    static const Form none;
    const auto operand = [&](int at) -> const Form& { return at < 0 ? none : forms[at]; };
    const Form &a = operand(node.a), &b = operand(node.b), &c = operand(node.c);
    const int operands = NumOperands(node.operation);
    const bool numbers = a.number && (operands < 2 || b.number) && (operands < 3 || c.number);
    Form form;
    if (node.operation == kMultiply && (is(a, 0) || is(b, 0))) {
      form.number = 0;
    } else if (numbers) {
      form.number = Apply(node.operation, *a.number, b.number.value_or(0), c.number.value_or(0));
    } else if (node.operation == kAdd || node.operation == kSubtract) {
      form = sum(a, node.operation == kAdd ? 1 : -1, b);
    } else if (node.operation == kNegate) {
      form = scaled(a, -1);
    } else if (node.operation == kMultiply && (a.number || b.number)) {
      form = a.number ? scaled(b, *a.number) : scaled(a, *b.number);
    } else if (node.operation == kDivide && b.number) {
      form = scaled(a, 1 / *b.number);
    } else if (node.operation == kPower && is(b, 1)) {
      form = a;
    } else if (node.operation == kWhere && a.number) {
      form = *a.number != 0 ? b : c;
    } else {
      form.is_affine = a.is_affine && b.is_affine && c.is_affine && a.by.empty() && b.by.empty() && c.by.empty();
    }
    if (!form.is_affine) form.by.clear();
    forms.push_back(std::move(form));
  }
  std::vector<LinearFlow::Entry> entries;
  for (std::size_t row = 0; row < graph.outputs.size(); ++row) {
    const Form& form = forms[graph.outputs[row]];
    if (!form.is_affine) return std::nullopt;
    for (const auto& [input, by] : form.by) {
      if (!std::isfinite(by)) return std::nullopt;
      if (by != 0) entries.push_back({static_cast<int>(row), input, by});
    }
  }
  return entries;
}

// A graph in which equal nodes are one, and operations on constants, zeros and ones are done away with.
class RecordedFunction::Builder {
 public:
  explicit Builder(const ExpressionGraph& recording) : num_inputs_(recording.num_inputs) {
    std::vector<int> of_node;
    for (const ExpressionGraph::Node& node : recording.nodes) {
      const auto at = [&](int operand) { return operand < 0 ? -1 : of_node[operand]; };
      if (node.operation == Operation::kConstant) {
        of_node.push_back(Constant(node.value));
      } else if (node.operation == Operation::kInput) {
        of_node.push_back(Add({Operation::kInput, node.a, -1, -1, 0}));
      } else {
        of_node.push_back(Make(node.operation, at(node.a), at(node.b), at(node.c)));
      }
    }
    for (const int output : recording.outputs) outputs_.push_back(of_node[output]);
  }

  Tape Values() const { return Flatten({}); }

  // Returns the graph for the function FlowAlong below, of which these are the outputs.
  ExpressionGraph FlowAlong(int n, int k) && {
    using enum Operation;
    const std::vector<int> beside = std::move(outputs_);
    const auto flow = [&](int number, int row) { return beside[(number + 1) * n + row]; };  // number -1: below all
    const auto change = [&](int number, int row) { return Make(kSubtract, flow(number, row), flow(-1, row)); };
    // The rates of the numbers, row by row: those of the changes, and minus that of the flow below all.
    std::vector<std::vector<int>> rates(k, std::vector<int>(k + 1, Constant(0)));
    for (int i = 0; i < k; ++i) {
      const Derivative gradient = DerivativeOf(beside[(k + 1) * n + i]);
      for (const auto& [input, partial] : gradient) {
        if (input > n) continue;
        for (int j = 0; j < k && input < n; ++j) {
          rates[i][j] = Make(kAdd, rates[i][j], Make(kMultiply, partial, change(j, input)));
        }
        const int rate = input < n ? Make(kMultiply, partial, flow(-1, input)) : partial;
        rates[i][k] = Make(kSubtract, rates[i][k], rate);
      }
    }
    // Gauss elimination finds the weights of the flows above.
    for (int i = 0; i < k; ++i) {
      for (int row = 0; row < k; ++row) {
        if (row == i) continue;
        const int factor = Make(kDivide, rates[row][i], rates[i][i]);
        for (int j = i + 1; j <= k; ++j) {
          rates[row][j] = Make(kSubtract, rates[row][j], Make(kMultiply, factor, rates[i][j]));
        }
      }
    }
    std::vector<int> weights;
    for (int i = 0; i < k; ++i) weights.push_back(Make(kDivide, rates[i][k], rates[i][i]));
    ExpressionGraph along{.num_inputs = num_inputs_};
    for (int row = 0; row < n; ++row) {
      int sum = flow(-1, row);
      for (int i = 0; i < k; ++i) sum = Make(kAdd, sum, Make(kMultiply, weights[i], change(i, row)));
      along.outputs.push_back(sum);
    }
    for (const int weight : weights) {
      along.outputs.insert(along.outputs.end(), {weight, Make(kSubtract, Constant(1), weight)});
    }
    along.nodes = std::move(nodes_);
    return along;
  }

  // Returns the graph for the function GradientOf below.
  ExpressionGraph GradientOf(int n) && {
    const Derivative by = DerivativeOf(outputs_.front());
    ExpressionGraph gradient{.num_inputs = num_inputs_};
    for (int i = 0; i < n; ++i) gradient.outputs.push_back(by.contains(i) ? by.at(i) : Constant(0));
    gradient.nodes = std::move(nodes_);
    return gradient;
  }

  Tape Derivatives() {
    std::vector<Tape::Entry> entries;
    for (std::size_t row = 0; row < outputs_.size(); ++row) {
      for (const auto& [column, node] : DerivativeOf(outputs_[row])) {
        entries.push_back({static_cast<int>(row), column, node});
      }
    }
    return Flatten(std::move(entries));
  }

 private:
  using Node = ExpressionGraph::Node;
  using Derivative = std::map<int, int>;  // from inputs to nodes

  int Add(const Node& node) {
    const auto key = std::tuple(node.operation, node.a, node.b, node.c, std::bit_cast<std::uint64_t>(node.value));
    const auto [found, is_new] = known_.try_emplace(key, static_cast<int>(nodes_.size()));
    if (is_new) nodes_.push_back(node);
    return found->second;
  }
  int Constant(double value) { return Add({Operation::kConstant, -1, -1, -1, value}); }
  bool IsConstant(int node) const { return node >= 0 && nodes_[node].operation == Operation::kConstant; }
  bool EqualsConstant(int node, double value) const { return IsConstant(node) && nodes_[node].value == value; }

  int Make(Operation operation, int a, int b = -1, int c = -1) {
    if (operation == Operation::kWhere) {
      if (IsConstant(a)) return nodes_[a].value != 0 ? b : c;
      if (b == c) return b;
      return Add({operation, a, b, c, 0});
    }
    if (operation == Operation::kProductTerm) {
      return IsConstant(a) || IsConstant(b) ? Make(Operation::kMultiply, a, b) : Add({operation, a, b, c, 0});
    }
    if (IsConstant(a) && (b < 0 || IsConstant(b))) {
      return Constant(Apply(operation, nodes_[a].value, b < 0 ? 0 : nodes_[b].value, 0));
    }
    using enum Operation;
    switch (operation) {
      case kAdd:
        if (EqualsConstant(a, 0)) return b;
        if (EqualsConstant(b, 0)) return a;
        if (a > b) std::swap(a, b);
        break;
      case kSubtract:
        if (EqualsConstant(b, 0)) return a;
        if (EqualsConstant(a, 0)) return Make(kNegate, b);
        break;
      case kMultiply:
        if (EqualsConstant(a, 0) || EqualsConstant(b, 0)) return Constant(0);
        if (EqualsConstant(a, 1)) return b;
        if (EqualsConstant(b, 1)) return a;
        if (EqualsConstant(a, -1)) return Make(kNegate, b);
        if (EqualsConstant(b, -1)) return Make(kNegate, a);
        if (a > b) std::swap(a, b);
        break;
      case kDivide:
        if (EqualsConstant(a, 0)) return a;
        if (EqualsConstant(b, 1)) return a;
        break;
      case kNegate:
        if (nodes_[a].operation == kNegate) return nodes_[a].a;
        break;
      case kPower:
        if (!IsConstant(b)) break;
        return PowerOf(a, nodes_[b].value, b);
      default:
        break;
    }
    return Add({operation, a, b, c, 0});
  }

  int PowerOf(int a, double exponent, int exponent_node) {
    if (exponent == 0) return Constant(1);
    if (exponent == 0.5) return Make(Operation::kSqrt, a);
    const double times = std::abs(exponent);
    if (times != std::round(times) || times > kMostMultiplications) {
      return Add({Operation::kPower, a, exponent_node, -1, 0});
    }
    int product = a;
    for (int i = 1; i < static_cast<int>(times); ++i) product = Make(Operation::kMultiply, product, a);
    return exponent > 0 ? product : Make(Operation::kDivide, Constant(1), product);
  }

  // The derivative of a function of one variable at `a`, whose own node is `node`; -1 if it is zero everywhere.
  int SlopeOf(Operation operation, int a, int node) {
    using enum Operation;
    const auto squared = [&](int of) { return Make(kMultiply, of, of); };
    const auto over = [&](int below) { return Make(kDivide, Constant(1), below); };
    switch (operation) {
      case kNegate:
        return Constant(-1);
      case kAbs:
        return Make(kSign, a);
      case kSqrt:
        return Make(kDivide, Constant(0.5), node);
      case kExp:
        return node;
      case kExpm1:
        return Make(kAdd, node, Constant(1));
      case kLog:
        return over(a);
      case kLog1p:
        return over(Make(kAdd, a, Constant(1)));
      case kSin:
        return Make(kCos, a);
      case kCos:
        return Make(kNegate, Make(kSin, a));
      case kTan:
        return Make(kAdd, Constant(1), squared(node));
      case kAsin:
        return over(Make(kSqrt, Make(kSubtract, Constant(1), squared(a))));
      case kAcos:
        return Make(kNegate, over(Make(kSqrt, Make(kSubtract, Constant(1), squared(a)))));
      case kAtan:
        return over(Make(kAdd, Constant(1), squared(a)));
      case kSinh:
        return Make(kCosh, a);
      case kCosh:
        return Make(kSinh, a);
      case kTanh:
        return Make(kSubtract, Constant(1), squared(node));
      case kAsinh:
        return over(Make(kSqrt, Make(kAdd, squared(a), Constant(1))));
      case kAcosh:
        return over(Make(kSqrt, Make(kSubtract, squared(a), Constant(1))));
      case kAtanh:
        return over(Make(kSubtract, Constant(1), squared(a)));
      case kErf:
        return Make(kMultiply, Constant(2 / std::sqrt(M_PI)), Make(kExp, Make(kNegate, squared(a))));
      default:
        return -1;
    }
  }

  // Whether a node's value is continuous and need not have a derivative, as that of hypot at rest.
  bool HasKink(int at) { return ParticularsOf(at) == kRoot; }
  int ParticularsOf(int at) {
    const auto [known, is_new] = particulars_.try_emplace(at, 0);
    if (!is_new) return known->second;
    const Node node = nodes_[at];
    using enum Operation;
    int found = node.operation == kSqrt || node.operation == kPower ? kRoot : node.operation == kAtan2 ? kAngle : 0;
    for (int j = 0; j < NumOperands(node.operation); ++j) found |= ParticularsOf(std::array{node.a, node.b, node.c}[j]);
    return particulars_[at] = found;
  }

  // The derivatives of a node's value by the values of its operands; -1 where it is zero everywhere.
  std::array<int, 3> PartialsOf(int at) {
    using enum Operation;
    const Node node = nodes_[at];
    const int a = node.a, b = node.b;
    switch (node.operation) {
      case kAdd:
        return {Constant(1), Constant(1), -1};
      case kSubtract:
        return {Constant(1), Constant(-1), -1};
      case kMultiply:
      case kProductTerm:
        return {b, a, -1};
      case kDivide:
        return {Make(kDivide, Constant(1), b), Make(kNegate, Make(kDivide, at, b)), -1};
      case kPower: {
        const int by_base = Make(kMultiply, b, Make(kPower, a, Make(kSubtract, b, Constant(1))));
        return {by_base, IsConstant(b) ? -1 : Make(kMultiply, at, Make(kLog, a)), -1};
      }
      case kAtan2: {
        const int square = Make(kAdd, Make(kMultiply, a, a), Make(kMultiply, b, b));
        return {Make(kDivide, b, square), Make(kNegate, Make(kDivide, a, square)), -1};
      }
      default:
        return {SlopeOf(node.operation, a, at), -1, -1};
    }
  }

  // Returns the derivative of a node; those of the nodes before it are found first.
  const Derivative& DerivativeOf(int at) {
    if (const auto found = derivatives_.find(at); found != derivatives_.end()) return found->second;
    const Node node = nodes_[at];
    Derivative result;
    if (node.operation == Operation::kInput) {
      result[node.a] = Constant(1);
    } else if (node.operation == Operation::kWhere) {
      const Derivative yes = DerivativeOf(node.b), no = DerivativeOf(node.c);
      for (const Derivative* side : {&yes, &no}) {
        for (const auto& [input, unused] : *side) {
          const auto of = [&](const Derivative& d) { return d.contains(input) ? d.at(input) : Constant(0); };
          result[input] = Make(Operation::kWhere, node.a, of(yes), of(no));
        }
      }
    } else if (node.operation != Operation::kConstant) {
      const std::array<int, 3> operands = {node.a, node.b, node.c}, partials = PartialsOf(at);
      for (int j = 0; j < NumOperands(node.operation); ++j) {
        if (partials[j] < 0) continue;
        const Derivative of_operand = DerivativeOf(operands[j]);
        // Where one factor is zero, and has a derivative, the other one need only be continuous: as hypot(v, w) is in
        // v hypot(v, w) at rest.
        const bool of_product =
            node.operation == Operation::kMultiply || (node.operation == Operation::kDivide && j == 1);
        const bool with_kink = of_product && HasKink(operands[j]);
        const Derivative beside = with_kink ? DerivativeOf(operands[1 - j]) : Derivative();
        for (const auto& [input, inner] : of_operand) {
          const int of_other = with_kink ? beside.contains(input) ? beside.at(input) : Constant(0) : -1;
          const int product =
              Make(with_kink ? Operation::kProductTerm : Operation::kMultiply, partials[j], inner, of_other);
          const auto [entry, is_new] = result.try_emplace(input, product);
          if (!is_new) entry->second = Make(Operation::kAdd, entry->second, product);
        }
      }
    }
    std::erase_if(result, [&](const auto& entry) { return EqualsConstant(entry.second, 0); });
    return derivatives_[at] = std::move(result);
  }

  // Returns a tape of the nodes that the outputs and the entries, which name nodes, depend on.
  Tape Flatten(std::vector<Tape::Entry> entries) const {
    std::vector<char> needed(nodes_.size());
    for (const int output : outputs_) needed[output] = 1;
    for (const Tape::Entry& entry : entries) needed[entry.slot] = 1;
    for (int i = static_cast<int>(nodes_.size()) - 1; i >= 0; --i) {
      if (!needed[i] || nodes_[i].operation == Operation::kInput) continue;
      for (const int operand : {nodes_[i].a, nodes_[i].b, nodes_[i].c}) {
        if (operand >= 0) needed[operand] = 1;
      }
    }
    Tape tape;
    std::vector<int> slots(nodes_.size(), -1);
    for (std::size_t i = 0; i < nodes_.size(); ++i) {
      if (!needed[i]) continue;
      if (nodes_[i].operation == Operation::kInput) slots[i] = nodes_[i].a;
      if (nodes_[i].operation != Operation::kConstant) continue;
      slots[i] = num_inputs_ + static_cast<int>(tape.constants.size());
      tape.constants.push_back(nodes_[i].value);
    }
    const int first = num_inputs_ + static_cast<int>(tape.constants.size());
    for (std::size_t i = 0; i < nodes_.size(); ++i) {
      if (!needed[i] || slots[i] >= 0) continue;
      const auto slot_of = [&](int node) { return node < 0 ? 0 : slots[node]; };
      slots[i] = first + static_cast<int>(tape.instructions.size());
      tape.instructions.push_back(
          {nodes_[i].operation, slot_of(nodes_[i].a), slot_of(nodes_[i].b), slot_of(nodes_[i].c)});
    }
    for (const int output : outputs_) tape.outputs.push_back(slots[output]);
    tape.entries = std::move(entries);
    for (Tape::Entry& entry : tape.entries) entry.slot = slots[entry.slot];
    tape.size = first + tape.instructions.size();
    std::vector<int> reads;
    for (std::size_t i = 0; i < nodes_.size(); ++i) {
      if (needed[i] && nodes_[i].operation == Operation::kInput) reads.push_back(nodes_[i].a);
    }
    std::ranges::sort(reads);
    if (kFewReads * static_cast<int>(reads.size()) < num_inputs_) tape.few_reads = std::move(reads);
    return tape;
  }

  const int num_inputs_;
  std::vector<Node> nodes_;
  std::vector<int> outputs_;
  std::map<std::tuple<Operation, int, int, int, std::uint64_t>, int> known_;
  std::map<int, Derivative> derivatives_;
  static constexpr int kRoot = 1, kAngle = 2;
  std::map<int, int> particulars_;
};

ExpressionGraph FlowAlong(const ExpressionGraph& beside, int n, int k) {
  return RecordedFunction::Builder(beside).FlowAlong(n, k);
}

ExpressionGraph GradientOf(const ExpressionGraph& graph, int n) {
  return RecordedFunction::Builder(graph).GradientOf(n);
}

RecordedFunction::RecordedFunction(const ExpressionGraph& recording)
    : recording_(recording),
      num_inputs_(recording.num_inputs),
      num_outputs_(static_cast<int>(recording.outputs.size())) {
  CHECK_EQ(Validate(recording), "");
  Builder builder(recording);
  values_ = builder.Values();
  derivatives_ = builder.Derivatives();
  may_break_ = std::ranges::any_of(values_.instructions, [](const Tape::Instruction& at) {
    using enum Operation;
    return at.operation == kWhere || at.operation == kAbs || at.operation == kSign || at.operation == kFloor ||
           at.operation == kLess || at.operation == kLessEqual;
  });
}

// Evaluates a function, or it and its derivatives, at inputs of which any may be changed from one time to the next.
class RecordedFunction::Evaluation {
 public:
  Evaluation(const RecordedFunction& function, bool with_derivatives, std::span<const Part> inputs)
      : tape_(with_derivatives ? function.derivatives_ : function.values_), slots_(memory_.Allocate(tape_.size)) {
    double* next = slots_;
    if (!tape_.few_reads) {
      for (const Part& part : inputs) next = std::copy_n(part.data, part.size, next);
    } else {
      const Part* part = inputs.data();
      slots_[0] = 0;  // in the place of operands that an operation does not have
      for (const int input : *tape_.few_reads) {
        for (; input >= next - slots_ + part->size; ++part) next += part->size;
        slots_[input] = part->data[input - (next - slots_)];
      }
      next = slots_ + function.num_inputs_;
    }
    results_ = std::copy(tape_.constants.begin(), tape_.constants.end(), next);
  }
  Evaluation(const Evaluation&) = delete;
  Evaluation& operator=(const Evaluation&) = delete;

  // Evaluates a flow at another state and time, which come first. The state: n numbers, or an array of them.
  template <typename State>
  void Run(const State& x, int n, double t, double* outputs) {
    if constexpr (std::is_array_v<State>) {
      std::copy_n(x, std::extent_v<State>, slots_);  // in place, where n numbers take a call
    } else {
      std::copy_n(x, n, slots_);
    }
    slots_[n] = t;
    Run(outputs);
  }
  [[gnu::noinline]] void Run(double* outputs);
  // Derivatives where they are not always zero, after Run.
  const std::vector<Tape::Entry>& entries() const { return tape_.entries; }
  double operator[](const Tape::Entry& entry) const { return slots_[entry.slot]; }

 private:
  const Tape& tape_;
  Memory memory_;
  double *slots_, *results_;
};

void RecordedFunction::Evaluation::Run(double* outputs) {
  double* next = results_;
  const double* at = slots_;
  for (const Tape::Instruction& instruction : tape_.instructions) {
    const double a = at[instruction.a];
    // The most frequent ones without a call.
    switch (instruction.operation) {
      case Operation::kAdd:
        *next++ = a + at[instruction.b];
        break;
      case Operation::kSubtract:
        *next++ = a - at[instruction.b];
        break;
      case Operation::kMultiply:
        *next++ = a * at[instruction.b];
        break;
      case Operation::kDivide:
        *next++ = a / at[instruction.b];
        break;
      case Operation::kNegate:
        *next++ = -a;
        break;
      case Operation::kSqrt:
        *next++ = std::sqrt(a);
        break;
      default:
        *next++ = Apply(instruction.operation, a, at[instruction.b], at[instruction.c]);
    }
  }
  for (const int slot : tape_.outputs) *outputs++ = at[slot];
}

// Evaluates instructions at kCount inputs together; every slot has kCount numbers.
template <int kCount, typename Instruction>
void RunTogether(const std::vector<Instruction>& instructions, const double* slots, double* results) {
  for (const Instruction& instruction : instructions) {
    const double *a = slots + instruction.a * kCount, *b = slots + instruction.b * kCount;
    const auto evaluate = [&](const auto& operation) {
#pragma GCC ivdep
      for (int i = 0; i < kCount; ++i) results[i] = operation(a[i], b[i]);
    };
    switch (instruction.operation) {
      case Operation::kAdd:
        evaluate([](double x, double y) { return x + y; });
        break;
      case Operation::kSubtract:
        evaluate([](double x, double y) { return x - y; });
        break;
      case Operation::kMultiply:
        evaluate([](double x, double y) { return x * y; });
        break;
      case Operation::kDivide:
        evaluate([](double x, double y) { return x / y; });
        break;
      case Operation::kNegate:
        evaluate([](double x, double) { return -x; });
        break;
      default:
        for (int i = 0; i < kCount; ++i) {
          results[i] = Apply(instruction.operation, a[i], b[i], slots[instruction.c * kCount + i]);
        }
    }
    results += kCount;
  }
}

void RecordedFunction::Evaluate(std::span<const Part> inputs, double* outputs) const {
  Evaluation(*this, false, inputs).Run(outputs);
}

std::vector<Bounds> RecordedFunction::Tape::BoundSlots(std::span<const Bounds> inputs) const {
  std::vector<Bounds> slots(inputs.begin(), inputs.end());
  slots.reserve(size);
  for (const double constant : constants) slots.push_back({constant, constant});
  for (const Instruction& at : instructions) {
    const bool is_square = at.operation == Operation::kMultiply && at.a == at.b;
    slots.push_back(is_square ? ApplyToBounds(Operation::kPower, slots[at.a], {2, 2}, {})
                              : ApplyToBounds(at.operation, slots[at.a], slots[at.b], slots[at.c]));
  }
  return slots;
}

void RecordedFunction::Bound(std::span<const Bounds> inputs, Bounds* outputs) const {
  const std::vector<Bounds> slots = values_.BoundSlots(inputs.first(num_inputs_));
  for (const int slot : values_.outputs) *outputs++ = slots[slot];
}

Bounds RecordedFunction::BoundRate(std::span<const Bounds> inputs, std::span<const Bounds> slopes) const {
  const std::vector<Bounds> slots = derivatives_.BoundSlots(inputs.first(num_inputs_));
  const int n = static_cast<int>(slopes.size());
  Bounds rate;
  for (const Tape::Entry& entry : derivatives_.entries) {
    if (entry.row > 0 || entry.column > n) continue;
    const Bounds slope = entry.column < n ? slopes[entry.column] : Bounds{1, 1};
    const Bounds term = ApplyToBounds(Operation::kMultiply, slots[entry.slot], slope, {});
    rate = ApplyToBounds(Operation::kAdd, rate, term, {});
  }
  return rate;
}

bool RecordedFunction::MayHideChanges() const {
  using enum Operation;
  constexpr double kLargePower = 16;
  return std::ranges::any_of(values_.instructions, [&](const Tape::Instruction& at) {
    const auto number = static_cast<std::size_t>(at.b - num_inputs_);
    const bool by_constant = number < values_.constants.size();
    if (at.operation == kPower) return !by_constant || std::abs(values_.constants[number]) >= kLargePower;
    return (at.operation == kDivide && !by_constant) || at.operation == kExp || at.operation == kExpm1 ||
           at.operation == kSinh || at.operation == kCosh || at.operation == kTanh || at.operation == kErf ||
           at.operation == kTan;
  });
}

void RecordedFunction::Linearize(std::span<const Part> inputs, int columns, double* outputs, double* jacobian) const {
  Evaluation at(*this, true, inputs);
  at.Run(outputs);
  std::fill_n(jacobian, num_outputs_ * columns, 0.0);
  for (const Tape::Entry& entry : at.entries()) {
    if (entry.column < columns) jacobian[entry.row * columns + entry.column] = at[entry];
  }
}

void RecordedFunction::Linearize(std::span<const Part> inputs, double* outputs, double** jacobians) const {
  Evaluation at(*this, true, inputs);
  at.Run(outputs);
  for (std::size_t i = 0; i < inputs.size(); ++i) {
    if (jacobians[i] != nullptr) std::fill_n(jacobians[i], num_outputs_ * inputs[i].size, 0.0);
  }
  for (const Tape::Entry& entry : at.entries()) {
    std::size_t block = 0;
    int column = entry.column;
    for (; column >= inputs[block].size; ++block) column -= inputs[block].size;
    if (jacobians[block] != nullptr) jacobians[block][entry.row * inputs[block].size + column] = at[entry];
  }
}

RecordedSystem::RecordedSystem(HybridLayout layout, std::vector<Mode> modes, bool slides)
    : HybridFunctions(std::move(layout)),
      modes_(std::move(modes)),
      slides_(slides),
      no_control_(this->layout().num_controls, 0.0) {
  const std::vector<int>& sizes = this->layout().state_sizes;
  CHECK_EQ(modes_.size(), sizes.size());
  for (std::size_t mode = 0; mode < modes_.size(); ++mode) {
    const int of_guards = sizes[mode] + 1 + num_parameters();
    CHECK_EQ(modes_[mode].flow.num_inputs(), of_guards + this->layout().num_controls);
    CHECK_EQ(modes_[mode].flow.num_outputs(), sizes[mode]);
    if (const auto& fly = modes_[mode].fly) {
      CHECK_EQ(fly->num_inputs(), modes_[mode].flow.num_inputs() + 1);
      CHECK_EQ(fly->num_outputs(), sizes[mode]);
    }
    CHECK_EQ(static_cast<int>(modes_[mode].transitions.size()), this->layout().num_guards[mode]);
    for (const Transition& transition : modes_[mode].transitions) {
      CHECK(transition.guard.num_inputs() == of_guards ||
            transition.guard.num_inputs() == modes_[mode].flow.num_inputs());
      CHECK_EQ(transition.guard.num_outputs(), 1);
      CHECK_EQ(transition.reset.num_inputs(), of_guards);
      CHECK_EQ(transition.reset.num_outputs(), sizes[transition.next_mode]);
    }
  }
  for (std::size_t i = 0; i < modes_.size(); ++i) {
    linear_.push_back(modes_[i].fly ? std::nullopt : LinearFlowOf(static_cast<int>(i), modes_[i].flow));
  }
  for (std::size_t i = 0; i < modes_.size(); ++i) {
    const Mode& mode = modes_[i];
    Evaluated as_recorded{
        static_cast<int>(i), sizes[i], &mode.flow, {}, mode.fly ? &*mode.fly : nullptr, nullptr, {}, {}, {}};
    std::vector<const ExpressionGraph*> functions = {&mode.flow.recording()};
    for (const Transition& transition : mode.transitions) {
      as_recorded.guards.push_back(&transition.guard);
      functions.push_back(&transition.guard.recording());
    }
    if (linear_[i]) as_recorded.linear = &*linear_[i];
    if (mode.fly) functions.push_back(&mode.fly->recording());
    auto switches = std::make_unique<const RecordedSwitches>(functions, sizes[i]);
    most_guards_ = std::max(most_guards_, static_cast<int>(mode.transitions.size()) + 2 * switches->count());
    switches_.push_back(switches->count() > 0 ? switches.get() : nullptr);
    conditions_.push_back(std::move(switches));
    parts_.emplace_back();
    if (linear_[i] && switches_.back() == nullptr) {
      auto parts =
          std::make_unique<const LinearParts>(mode.flow,
                                              *AffineDerivatives(mode.flow.recording(), mode.flow.num_inputs()),
                                              mode.transitions,
                                              sizes[i],
                                              num_parameters(),
                                              this->layout().num_controls);
      if (!parts->parts().empty()) parts_.back() = std::move(parts);
    }
    Keep(std::move(as_recorded));
  }
}

RecordedSystem::~RecordedSystem() {
  for (std::atomic<Evaluated*>& block : blocks_) delete[] block.load();
}

std::optional<LinearFlow> RecordedSystem::LinearFlowOf(int base, const RecordedFunction& flow) const {
  const int n = layout().state_sizes[base], columns = n + 1 + num_parameters() + layout().num_controls;
  if (n > LinearFlow::kMostStates) return std::nullopt;
  const auto derivatives = AffineDerivatives(flow.recording(), columns);
  if (!derivatives) return std::nullopt;
  return LinearFlow(n, columns, *derivatives);
}

// Precondition: mutex_ is held, or no other thread knows of this object.
int RecordedSystem::Keep(Evaluated mode) const {
  const int index = num_modes_;
  mode.may_hide_changes =
      mode.flow->MayHideChanges() || std::ranges::any_of(mode.guards, &RecordedFunction::MayHideChanges);
  const auto number = static_cast<unsigned>(index) + 1;
  const int block = std::bit_width(number) - 1;
  CHECK_LT(block, kBlocks);
  if (blocks_[block] == nullptr) blocks_[block] = new Evaluated[1u << block];
  blocks_[block][number - (1u << block)] = std::move(mode);
  num_modes_.store(index + 1, std::memory_order_release);
  return index;
}

int RecordedSystem::PieceOf(int base, std::vector<int> sides) const {
  const std::lock_guard lock(mutex_);
  const auto [known, is_new] = known_.try_emplace({base, sides}, num_modes());
  if (!is_new) return known->second;
  const RecordedSwitches& switches = *switches_[base];
  Evaluated piece{base, layout().state_sizes[base], nullptr, {}, nullptr, nullptr, sides, {}, {}};
  if (modes_[base].fly) piece.floors = {0};  // functions of such a mode have the length of a flight as an input
  for (const double floor : switches.Floors(sides)) piece.floors.push_back(floor);
  std::vector<int> kind = sides;  // except for integer parts
  for (int number = 0; number < switches.count(); ++number) {
    if (sides[number] == RecordedSwitches::kIrrelevant) continue;
    const bool slides = switches.Slides(number, sides);
    piece.switches.push_back({number, -1, slides});
    if (slides || switches.IsFloor(number)) piece.switches.push_back({number, 1, slides});
    if (switches.IsFloor(number)) kind[number] = 0;
  }
  const int num_guards = static_cast<int>(modes_[base].transitions.size());
  const auto sliding = std::ranges::count_if(piece.switches, [](const End& end) { return end.slides; }) / 2;
  std::optional<ExpressionGraph> along;  // the flow, then the ends of the piece by the switches along which it slides
  const auto output_along = [&](int first, int count, std::vector<int>* used) {
    const int n = layout().state_sizes[base];
    if (!along) along = FlowAlong(switches.CornerFunctions(sides), n, static_cast<int>(sliding));
    ExpressionGraph graph = *along;
    graph.outputs.assign(along->outputs.begin() + first, along->outputs.begin() + first + count);
    used->resize(switches.count());
    std::iota(used->begin(), used->end(), 0);
    return graph;
  };
  const Shared& flow = SharedBy({base, 0, 0}, kind, [&](std::vector<int>* used) {
    return sliding > 0 ? output_along(0, layout().state_sizes[base], used) : switches.Function(0, sides, used);
  });
  piece.flow = &flow.function;
  piece.linear = flow.linear ? &*flow.linear : nullptr;
  for (int i = 1; i <= num_guards; ++i) {
    const auto make = [&](std::vector<int>* used) { return switches.Function(i, sides, used); };
    piece.guards.push_back(&SharedBy({base, i, 0}, kind, make).function);
  }
  int end_along = layout().state_sizes[base];
  for (const End& end : piece.switches) {
    const auto make = [&](std::vector<int>* used) {
      return end.slides ? output_along(end_along, 1, used) : switches.Guard(end.number, end.by, sides, used);
    };
    piece.guards.push_back(&SharedBy({base, num_guards + 2 + end.number, end.by}, kind, make).function);
    if (end.slides) ++end_along;
  }
  if (modes_[base].fly && sliding == 0) {
    const auto make = [&](std::vector<int>* used) { return switches.Function(1 + num_guards, sides, used); };
    piece.fly = &SharedBy({base, 1 + num_guards, 0}, kind, make).function;
  }
  return Keep(std::move(piece));
}

template <typename Make>
const RecordedSystem::Shared& RecordedSystem::SharedBy(std::tuple<int, int, int> key, const std::vector<int>& sides,
                                                       const Make& make) const {
  std::deque<Shared>& known = shared_[key];
  const auto same = [&](const std::pair<int, int>& of) { return sides[of.first] == of.second; };
  for (const Shared& shared : known) {
    if (std::ranges::all_of(shared.sides, same)) return shared;
  }
  std::vector<int> used;
  Shared made{{}, RecordedFunction(make(&used)), {}};
  for (const int number : used) made.sides.emplace_back(number, sides[number]);
  const auto [base, function, by] = key;
  if (function == 0 && !modes_[base].fly) made.linear = LinearFlowOf(base, made.function);
  return known.emplace_back(std::move(made));
}

std::vector<double> RecordedSystem::SwitchInputsAt(const ModePoint& point) const {
  std::vector<double> inputs;
  for (const RecordedFunction::Part& part : InputsAt(point))
    inputs.insert(inputs.end(), part.data, part.data + part.size);
  inputs.push_back(0);  // the length of a flight
  return inputs;
}

std::vector<int> RecordedSystem::SidesAt(const ModePoint& point, std::vector<int> known) const {
  return switches_[at(point.mode).base]->SidesAt(SwitchInputsAt(point), std::move(known));
}

int RecordedSystem::PieceAt(const ModePoint& point) const {
  const int base = at(point.mode).base;
  return switches_[base] == nullptr ? base : PieceOf(base, SidesAt({base, point.t, point.x, point.u, point.p}, {}));
}

int RecordedSystem::AdjacentPiece(const ModePoint& point, int guard, Side side) const {
  const Evaluated& piece = at(point.mode);
  const End& end = piece.switches[guard - (num_guards(point.mode) - num_switches(point.mode))];
  if (side == Side::kSliding) return PieceAlong(point, guard);
  const RecordedSwitches& switches = *switches_[piece.base];
  int to = static_cast<int>(side);
  if (switches.IsFloor(end.number)) {
    if (side == Side::kOn) return -1;
    to = piece.sides[end.number] + end.by;
  } else if (side == Side::kOther) {
    to = end.slides ? end.by : -piece.sides[end.number];
  }
  std::vector<int> sides = switches.WithSide(SwitchInputsAt(point), piece.sides, end.number, to);
  sides = SidesAt(point, std::move(sides));
  return sides.empty() ? -1 : PieceOf(piece.base, std::move(sides));
}

// Whether the flow at a point of a piece points at the zero of a switch.
bool RecordedSystem::PointsAt(const ModePoint& point, int number) const {
  if (point.mode < 0) return false;
  const Evaluated& piece = at(point.mode);
  const auto end = std::ranges::find_if(piece.switches, [&](const End& of) { return of.number == number; });
  if (end == piece.switches.end()) return false;
  std::vector<double> slope(size(point.mode));
  Flow(point, slope.data());
  double rate = 0;
  const auto guard = num_guards(point.mode) - (piece.switches.end() - end);
  GuardRate(point, static_cast<int>(guard), slope.data(), &rate);
  return rate < 0;
}

// The piece along a switch at whose zero a point is; -1 unless both sides point at it, and Filippov's convention
// determines the flow: the only function that depends on the switch is the flow, and its changes at several switches
// along which it slides add up, at random points nearby as well.
int RecordedSystem::PieceAlong(const ModePoint& point, int guard) const {
  constexpr double kApart = 0.1, kSame = 1e-9;  // relative: other points, and what is zero
  constexpr int kPoints = 3;
  const Evaluated& piece = at(point.mode);
  const RecordedSwitches& switches = *switches_[piece.base];
  const int number = piece.switches[guard - (num_guards(point.mode) - num_switches(point.mode))].number;
  if (!slides_ || switches.IsFloor(number)) return -1;
  for (const Side side : {Side::kBelow, Side::kAbove}) {
    const ModePoint beside{AdjacentPiece(point, guard, side), point.t, point.x, point.u, point.p};
    if (!PointsAt(beside, number)) return -1;
  }
  std::vector<int> sides = piece.sides;
  sides[number] = RecordedSwitches::kSliding;
  sides = SidesAt(point, std::move(sides));
  if (sides.empty() || !switches.OnlyFirstFunctionJumps(sides)) return -1;
  const int along = PieceOf(piece.base, sides);
  const RecordedFunction mixed(switches.MixedChanges(sides));
  if (mixed.num_outputs() == 0) return along;
  const ModePoint sliding{along, point.t, point.x, point.u, point.p};
  const Inputs inputs = InputsAt(sliding);
  std::vector<double> x(point.x, point.x + size(along)), slope(x.size()), changes(mixed.num_outputs());
  Flow({along, point.t, x.data(), point.u, point.p}, slope.data());
  NormalStream random(1);
  for (int i = 0; i < kPoints; ++i) {
    Inputs near = inputs;
    near[0].data = x.data();
    mixed.Evaluate(near, changes.data());
    for (std::size_t j = 0; j < changes.size(); ++j) {
      if (std::abs(changes[j]) > kSame * (1 + std::abs(slope[j % slope.size()]))) return -1;
    }
    for (double& value : x) value += kApart * (1 + std::abs(value)) * random.Next();
  }
  return along;
}

bool RecordedSystem::IsOn(int mode, int guard) const {
  if (!IsSwitch(mode, guard)) return false;
  const Evaluated& piece = at(mode);
  const int number = piece.switches[guard - (num_guards(mode) - num_switches(mode))].number;
  return !switches_[piece.base]->IsFloor(number) && piece.sides[number] == 0;
}

std::string RecordedSystem::GuardName(int mode, int guard) const {
  const Evaluated& piece = at(mode);
  const int first = num_guards(mode) - num_switches(mode);
  if (guard < first) return HybridFunctions::GuardName(piece.base, guard);
  return switches_[piece.base]->TextOf(piece.switches[guard - first].number, SwitchInputNames(mode));
}

std::vector<std::string> RecordedSystem::UndecidedConditions(const ModePoint& point) const {
  const Evaluated& piece = at(point.mode);
  const RecordedSwitches& conditions = *conditions_[piece.base];
  if (!conditions.HasFixedConditions()) return {};
  RecordedSwitches::Sides sides = piece.sides;
  sides.resize(conditions.count(), RecordedSwitches::kIrrelevant);
  return conditions.UndecidedAt(SwitchInputsAt(point), std::move(sides), SwitchInputNames(point.mode));
}

std::vector<std::string> RecordedSystem::SwitchInputNames(int mode) const {
  std::vector<std::string> names;
  for (int i = 0; i < size(mode); ++i) names.push_back(StateName(mode, i));
  names.push_back("t");
  const auto add = [&](const std::vector<std::string>& given, int count, const char* otherwise) {
    for (int i = 0; i < count; ++i) {
      names.push_back(given.empty() ? otherwise + ("[" + std::to_string(i) + "]") : given[i]);
    }
  };
  add(layout().parameter_names, num_parameters(), "p");
  add(layout().control_names, layout().num_controls, "u");
  names.emplace_back("s");
  return names;
}

bool RecordedSystem::ReadsControl(int mode, int guard) const {
  const Evaluated& piece = at(mode);
  const int first = num_guards(mode) - num_switches(mode), first_control = size(mode) + 1 + num_parameters();
  if (guard < first) return transition(mode, guard).guard.num_inputs() > first_control;
  if (piece.switches[guard - first].slides) return true;  // the share of a side is that of its flow
  return switches_[piece.base]->ReadsInputsFrom(first_control, piece.switches[guard - first].number);
}

void RecordedSystem::Flow(const ModePoint& at, double* xdot) const {
  this->at(at.mode).flow->Evaluate(InputsAt(at), xdot);
}

std::vector<Bounds> RecordedSystem::InputsIn(const ModeBox& box) const {
  std::vector<Bounds> inputs(box.x, box.x + size(box.mode));
  inputs.push_back(box.t);
  const ModePoint known{box.mode, 0, nullptr, box.u, box.p};
  const Inputs rest = InputsAt(known);
  for (const RecordedFunction::Part& part : std::span(rest).subspan(2)) {
    for (int i = 0; i < part.size; ++i) inputs.push_back({part.data[i], part.data[i]});
  }
  return inputs;
}

void RecordedSystem::Bound(const ModeBox& box, Bounds* slopes, Bounds* guards) const {
  const Evaluated& mode = at(box.mode);
  const std::vector<Bounds> inputs = InputsIn(box);
  mode.flow->Bound(inputs, slopes);
  for (const RecordedFunction* guard : mode.guards) guard->Bound(inputs, guards++);
}

Bounds RecordedSystem::BoundGuardRate(const ModeBox& box, int guard, const Bounds* slopes) const {
  return at(box.mode).guards[guard]->BoundRate(InputsIn(box), {slopes, static_cast<std::size_t>(size(box.mode))});
}

void RecordedSystem::FlowJacobian(const ModePoint& at, double* xdot, double* jacobian) const {
  this->at(at.mode).flow->Linearize(InputsAt(at), num_columns(at.mode), xdot, jacobian);
}

// A guard that does not read the control may be evaluated without one, though its recording has it among its inputs.
RecordedSystem::Inputs RecordedSystem::InputsAt(const ModePoint& at) const {
  const std::vector<double>& floors = this->at(at.mode).floors;
  return {{{at.x, size(at.mode)},
           {&at.t, 1},
           {at.p, num_parameters()},
           {at.u != nullptr ? at.u : no_control_.data(), layout().num_controls},
           {floors.data(), static_cast<int>(floors.size())}}};
}

std::span<const RecordedFunction::Part> RecordedSystem::InputsOf(const RecordedFunction& function,
                                                                 const Inputs& inputs) const {
  const int without_control = inputs[0].size + 1 + num_parameters();
  return {inputs.data(), function.num_inputs() == without_control ? 3 : inputs.size()};
}

void RecordedSystem::Step(const FlowStep& step, const double* slope, double* scratch, double* after,
                          double* slope_after) const {
  const int n = size(step.mode);
  const LinearFlow* linear = this->at(step.mode).linear;
  if (linear != nullptr) linear->Step(step.h, step.x, slope, after);
  if (linear != nullptr || Fly(step, after, nullptr)) {
    return Flow({step.mode, step.t + step.h, after, step.u, step.p}, slope_after);
  }
  RecordedFunction::Evaluation at(*this->at(step.mode).flow, /*with_derivatives=*/false, InputsAt(step));
  const auto flow = [&](double t, const auto& x, double* xdot) { at.Run(x, n, t, xdot); };
  EvaluateStep(n, step, flow, slope, scratch, after, slope_after);
}

// Pulls back by the derivatives that are not always zero. The stages follow each other in the evaluation of the flow
// only; its derivatives are then evaluated at all of them together, each operation in a loop over the stages.
bool RecordedSystem::PullBackStep(const FlowStep& step, const double* after, StepCotangent* out) const {
  const Evaluated& mode = this->at(step.mode);
  if (mode.fly != nullptr) return false;
  constexpr int kStages = cooper_verner::kStages;
  const int n = size(step.mode), columns = mode.flow->num_inputs();
  if (mode.linear != nullptr) {
    double slope[LinearFlow::kMostStates], state[LinearFlow::kMostStates];
    Flow(step, slope);
    mode.linear->Step(step.h, step.x, slope, state);
    Flow({step.mode, step.t + step.h, state, step.u, step.p}, slope);
    out->h = std::inner_product(slope, slope + n, after, 0.0);
    mode.linear->PullBack(step.h, after, num_parameters(), out);
    return true;
  }
  RecordedFunction::Evaluation at(*mode.flow, /*with_derivatives=*/false, InputsAt(step));
  const RecordedFunction::Tape& tape = mode.flow->derivatives_;
  Memory memory;
  double* slopes = memory.Allocate(kStages * (n + tape.size) + (kStages + 1) * n + columns);
  double *slots = slopes + kStages * n, *scratch = slots + kStages * tape.size;
  const auto flow = [&](double t, const auto& x, double* slope, double* of_stage) {
    at.Run(x, n, t, slope);
    for (int i = 0; i < n; ++i) of_stage[i * kStages] = x[i];
    of_stage[n * kStages] = t;
  };
  saltus::LinearizeStep(n, step, /*stride=*/1, flow, scratch, slopes, slots);
  double* next = slots + (n + 1) * kStages;
  const auto fill = [&](const double* numbers, std::size_t size) {
    for (std::size_t i = 0; i < size; ++i) next = std::fill_n(next, kStages, numbers[i]);
  };
  fill(step.p, num_parameters());
  fill(step.u, layout().num_controls);
  fill(mode.floors.data(), mode.floors.size());
  fill(tape.constants.data(), tape.constants.size());
  RunTogether<kStages>(tape.instructions, slots, next);
  const auto multiply = [&](int stage, const double* of_slope, double* of_stage) {
    std::fill_n(of_stage, columns, 0.0);
    for (const auto& entry : tape.entries) {
      of_stage[entry.column] += of_slope[entry.row] * slots[entry.slot * kStages + stage];
    }
  };
  DispatchSize(n, [&](auto known) {
    PullBackThroughStages<known>(
        n, num_parameters(), layout().num_controls, step.h, slopes, multiply, scratch, after, out);
  });
  return true;
}

bool RecordedSystem::Fly(const FlowStep& step, double* after, double* jacobian) const {
  const RecordedFunction* fly = at(step.mode).fly;
  if (const LinearFlow* linear = at(step.mode).linear) {
    double slope[LinearFlow::kMostStates];
    Flow(step, slope);
    linear->Step(step.h, step.x, slope, after);
    if (jacobian != nullptr) linear->Jacobian(step.h, jacobian);
    return true;
  }
  if (fly == nullptr) return false;
  auto [x, t, p, u, floors] = InputsAt(step);
  if (floors.size > 0) floors = {floors.data + 1, floors.size - 1};
  const std::array<RecordedFunction::Part, 6> inputs = {{x, t, p, u, {&step.h, 1}, floors}};
  if (jacobian == nullptr) {
    fly->Evaluate(inputs, after);
  } else {
    fly->Linearize(inputs, num_columns(step.mode), after, jacobian);
  }
  return true;
}

std::vector<StatePart> RecordedSystem::Parts(int mode) const {
  const bool is_divided = mode < std::ssize(parts_) && parts_[mode] != nullptr;
  return is_divided ? parts_[mode]->parts() : HybridFunctions::Parts(mode);
}

void RecordedSystem::MovePart(int part, const FlowStep& step, double* after, double* jacobian) const {
  parts_[step.mode]->Move(part, step, after, jacobian);
}

std::vector<int> RecordedSystem::PartsOf(int mode, int guard) const {
  const bool is_divided = mode < std::ssize(parts_) && parts_[mode] != nullptr;
  return is_divided ? parts_[mode]->PartsOf(guard) : HybridFunctions::PartsOf(mode, guard);
}

double RecordedSystem::Guard(const ModePoint& at, int guard) const {
  double value = 0;
  const RecordedFunction& function = *this->at(at.mode).guards[guard];
  function.Evaluate(InputsOf(function, InputsAt(at)), &value);
  return value;
}

template <typename Visit>
double RecordedSystem::LinearizeGuard(const ModePoint& at, int guard, const Visit& visit) const {
  const RecordedFunction& function = *this->at(at.mode).guards[guard];
  const Inputs inputs = InputsAt(at);
  RecordedFunction::Evaluation found(function, true, InputsOf(function, inputs));
  double value = 0;
  found.Run(&value);
  for (const auto& entry : found.entries()) visit(entry.column, found[entry]);
  return value;
}

double RecordedSystem::GuardRate(const ModePoint& at, int guard, const double* xdot, double* rate) const {
  const int n = size(at.mode);
  *rate = 0;
  return LinearizeGuard(at, guard, [&](int column, double by) {
    if (column <= n) *rate += column < n ? by * xdot[column] : by;
  });
}

double RecordedSystem::GuardGradient(const ModePoint& at, int guard, double* gradient) const {
  const int all = num_columns(at.mode);
  std::fill_n(gradient, all, 0.0);
  return LinearizeGuard(at, guard, [&](int column, double by) {
    if (column < all) gradient[column] = by;
  });
}

void RecordedSystem::AppendGuardTerms(const ModePoint& at, int guard, std::vector<GuardTerm>* terms) const {
  const int n = size(at.mode), all = num_columns(at.mode);
  const auto first = static_cast<std::ptrdiff_t>(terms->size());
  LinearizeGuard(at, guard, [&](int column, double by) {
    if (column < all && by != 0) terms->push_back({column, by});
  });
  std::stable_partition(terms->begin() + first, terms->end(), [n](const GuardTerm& term) { return term.input == n; });
}

int RecordedSystem::Reset(const ModePoint& at, int guard, double* x_plus) const {
  if (IsSwitch(at.mode, guard)) {
    std::copy_n(at.x, size(at.mode), x_plus);
    const Evaluated& piece = this->at(at.mode);
    const bool leaves = piece.switches[guard - (num_guards(at.mode) - num_switches(at.mode))].slides;
    const int along = leaves ? -1 : AdjacentPiece(at, guard, Side::kSliding);
    return along >= 0 ? along : AdjacentPiece(at, guard, Side::kOther);
  }
  const Transition& of = transition(at.mode, guard);
  of.reset.Evaluate(InputsOf(of.reset, InputsAt(at)), x_plus);
  return PieceAt({of.next_mode, at.t, x_plus, at.u, at.p});
}

int RecordedSystem::ResetJacobian(const ModePoint& at, int guard, double* x_plus, double* jacobian) const {
  const int n = size(at.mode), columns = n + 1 + num_parameters();
  if (IsSwitch(at.mode, guard)) {
    std::fill_n(jacobian, n * columns, 0.0);
    for (int i = 0; i < n; ++i) jacobian[i * columns + i] = 1;
    return Reset(at, guard, x_plus);
  }
  const Transition& of = transition(at.mode, guard);
  of.reset.Linearize(InputsOf(of.reset, InputsAt(at)), columns, x_plus, jacobian);
  return PieceAt({of.next_mode, at.t, x_plus, at.u, at.p});
}

RecordedCost::RecordedCost(RecordedFunction function, const std::vector<int>& block_sizes)
    : function_(std::move(function)) {
  int inputs = 0;
  for (const int size : block_sizes) inputs += size;
  CHECK_EQ(inputs, function_.num_inputs());
  CHECK_LE(block_sizes.size(), kMostBlocks);
  *mutable_parameter_block_sizes() = block_sizes;
  set_num_residuals(function_.num_outputs());
  if (!function_.MayBreak()) return;
  constexpr int kNoStates = -1;  // no input changes along a motion
  conditions_ = std::make_shared<RecordedSwitches>(std::vector{&function_.recording()}, kNoStates);
}

std::vector<std::string> RecordedCost::UndecidedAt(const std::vector<const double*>& blocks,
                                                   std::span<const std::string> names) const {
  if (conditions_ == nullptr) return {};
  std::vector<double> inputs;
  for (std::size_t i = 0; i < blocks.size(); ++i) {
    inputs.insert(inputs.end(), blocks[i], blocks[i] + parameter_block_sizes()[i]);
  }
  return conditions_->UndecidedAt(inputs, {}, names);
}

bool RecordedCost::Evaluate(double const* const* parameters, double* residuals, double** jacobians) const {
  std::array<RecordedFunction::Part, kMostBlocks> parts;
  const std::size_t count = parameter_block_sizes().size();
  for (std::size_t i = 0; i < count; ++i) parts[i] = {parameters[i], parameter_block_sizes()[i]};
  const std::span<const RecordedFunction::Part> inputs(parts.data(), count);
  if (jacobians != nullptr) {
    function_.Linearize(inputs, residuals, jacobians);
  } else {
    function_.Evaluate(inputs, residuals);
  }
  return true;
}

}  // namespace saltus
