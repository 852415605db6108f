#include "saltus/global/global_bound.h"

#include <algorithm>
#include <ctime>
#include <limits>
#include <map>
#include <memory>
#include <utility>

#include "global/relaxation.h"
#include "saltus/control/objective.h"
#include "saltus/scene/materials.h"

namespace saltus {
namespace {

using global::BoxBound;
using global::ImpactBox;
using global::kLargestTau;
using global::kMostParameters;
using global::Multipliers;
using global::Relaxation;

constexpr int kQuarters = 4;
constexpr double kTight = 0.1;  // of the first gap: boxes are stuck if their bound is as near to that at the middle
constexpr double kSmall = 0.1;  // of the whole range: or if they are smaller in all parameters
constexpr double kPartOfGap = 0.999;  // as far below the known loss are the wanted bounds, so that rounding is less
constexpr std::size_t kBoxesPerCheck = 256;
constexpr std::size_t kBytesOfMultipliers = 1024;  // about

struct Node {
  ImpactBox box;
  double lower = 0, own = 0;  // own: the bound of this box; `lower` may be that of one around it
  double at_middle = 0, least = 0;
  int split = -1;
  bool is_cut = false;                             // the bound is that of a larger box, of which the rest is excluded
  std::shared_ptr<const Multipliers> multipliers;  // of this box; those of its halves are no worse
};

std::size_t BytesOf(const Node& node) {
  return sizeof(Node) + kBytesOfMultipliers + node.box.sequence.size() * (sizeof(Candidate) + sizeof(int)) +
         2 * sizeof(double) * node.box.low.size() + 64;
}

class BranchAndBound {
 public:
  BranchAndBound(const Scene& scene, double upper, const GlobalOptions& options)
      : scene_(scene),
        options_(options),
        relaxation_(scene),
        pairs_(AllPairs(scene)),
        pushed_(scene.num_bodies(), false),
        aimed_(scene.num_bodies(), false),
        wanted_(upper - kPartOfGap * options.gap),
        start_(std::clock()) {
    out_.upper = upper;
    for (const int body : scene.control.bodies) pushed_[body] = true;
    for (const TerminalTerm& term : scene.objective.terminal) aimed_[term.body] = aimed_[term.body] || term.weight > 0;
  }

  GlobalBound Run() {
    Node root;
    root.box.open = true;
    Bound(std::move(root));
    if (!queue_.empty()) first_gap_ = wanted_ - queue_.front().lower;
    while (!queue_.empty()) {
      out_.lower = std::max(out_.lower, std::min({queue_.front().lower, final_lowest_, out_.upper}));
      if (out_.gap() <= options_.gap) break;
      if (IsOver()) {
        out_.interrupted = true;
        break;
      }
      Node node = Pop();
      if (!IsStuck(node) || !Divide(node)) Halve(node);
    }
    if (queue_.empty()) out_.lower = std::max(out_.lower, std::min(final_lowest_, out_.upper));
    Report();
    return std::move(out_);
  }

 private:
  static bool IsWorse(const Node& a, const Node& b) { return a.lower > b.lower; }

  void Push(Node node) {
    bytes_ += BytesOf(node);
    queue_.push_back(std::move(node));
    std::push_heap(queue_.begin(), queue_.end(), IsWorse);
  }
  Node Pop() {
    std::pop_heap(queue_.begin(), queue_.end(), IsWorse);
    Node node = std::move(queue_.back());
    queue_.pop_back();
    bytes_ -= BytesOf(node);
    return node;
  }

  bool IsOver() {
    if (options_.boxes > 0 && out_.boxes >= options_.boxes) return true;
    if (bytes_ > options_.memory) return true;
    if (out_.boxes < next_check_) return false;
    next_check_ = out_.boxes + kBoxesPerCheck;
    if (options_.progress) options_.progress(out_);
    if (options_.stop && options_.stop()) return true;
    return options_.seconds > 0 && static_cast<double>(std::clock() - start_) > options_.seconds * CLOCKS_PER_SEC;
  }

  double WholeRange(const ImpactBox& box, int parameter) const {
    for (size_t i = 0; i < box.sequence.size(); ++i) {
      if (box.TimeIndex(static_cast<int>(i)) == parameter) return scene_.duration;
    }
    return 2 * kLargestTau;
  }

  // Whether halving the box is not expected to exclude it: some point in it cannot be excluded, and its bound is about
  // as high as at its middle, or the box is small.
  bool IsStuck(const Node& node) const {
    if (node.split < 0) return true;
    if (!(node.least < wanted_)) return false;
    return node.own >= node.at_middle - kTight * first_gap_ || IsSmall(node.box);
  }

  bool IsSmall(const ImpactBox& box) const {
    for (int j = 0; j < box.num_parameters(); ++j) {
      if (box.high[j] - box.low[j] > kSmall * WholeRange(box, j)) return false;
    }
    return true;
  }

  // Whether every impact decides about the loss.
  bool IsRelevant(const ContactSequence& sequence) const {
    std::vector<bool> relevant = aimed_;
    for (auto pair = sequence.rbegin(); pair != sequence.rend(); ++pair) {
      if (!relevant[pair->a] && (pair->plane || !relevant[pair->b])) return false;
      relevant[pair->a] = true;
      if (!pair->plane) relevant[pair->b] = true;
    }
    return true;
  }

  bool Moves(const Candidate& pair, bool is_a) const {
    return is_a ? !scene_.bodies[pair.a].fixed : !pair.plane && !scene_.bodies[pair.b].fixed;
  }

  // Whether a pair may touch again before one of its discs touches another one: it needs a force, or gravity towards a
  // side that does not move. Otherwise the two separate in straight lines.
  bool MayRepeat(const Candidate& pair) const {
    for (const bool is_a : {true, false}) {
      if (Moves(pair, is_a) && pushed_[is_a ? pair.a : pair.b]) return true;
    }
    return !(Moves(pair, true) && Moves(pair, false)) && scene_.gravity != Vec2d::Zero();
  }

  // Whether no disc of the pair touches another one since its last impact: then the pair repeats that one.
  bool IsRepetition(const ContactSequence& sequence, const Candidate& pair) const {
    for (auto last = sequence.rbegin(); last != sequence.rend(); ++last) {
      if (*last == pair) return true;
      const auto has = [&](int body) { return last->a == body || (!last->plane && last->b == body); };
      for (const bool is_a : {true, false}) {
        if (Moves(pair, is_a) && has(is_a ? pair.a : pair.b)) return false;
      }
    }
    return false;
  }

  // Replaces a node by others that together have all its motions. Returns false if there are none.
  bool Divide(const Node& node) {
    const ImpactBox& box = node.box;
    if (!box.open) {
      const auto flag = std::find(box.repeated.begin(), box.repeated.end(), true);
      return flag != box.repeated.end() && Unfold(node, static_cast<int>(flag - box.repeated.begin()));
    }
    if (box.free_normal) {
      if (box.num_parameters() + 1 > kMostParameters) return false;
      for (int quarter = 0; quarter < kQuarters; ++quarter) {
        Node child = node;
        child.box.free_normal = false;
        child.box.quarters.back() = quarter;
        child.box.low.push_back(-kLargestTau);
        child.box.high.push_back(kLargestTau);
        Bound(std::move(child));
      }
      return true;
    }
    for (size_t i = 0; i < box.sequence.size(); ++i) {
      if (!box.repeated[i] || !box.sequence[i].plane || HasLast(box, static_cast<int>(i))) continue;
      if (Unfold(node, static_cast<int>(i))) return true;
    }
    if (box.num_parameters() + 1 > kMostParameters) return false;
    if (!box.sequence.empty()) {
      Node repeated = node;
      repeated.box.repeated.back() = MayRepeat(box.sequence.back());
      Continue(repeated);
    } else {
      Continue(node);
    }
    return true;
  }

  // Continues with no further relevant impact, or with one of another pair.
  void Continue(const Node& node) {
    if (IsRelevant(node.box.sequence)) {
      Node closed = node;
      closed.box.open = false;
      Bound(std::move(closed));
    }
    const int impacts = static_cast<int>(node.box.sequence.size());
    for (const Candidate& pair : pairs_) {
      if (IsRepetition(node.box.sequence, pair)) continue;
      Node child = node;
      ImpactBox& box = child.box;
      box.sequence.push_back(pair);
      box.quarters.push_back(0);
      box.repeated.push_back(false);
      box.free_normal = !pair.plane;
      box.low.push_back(impacts == 0 ? 0.0 : node.box.low[node.box.TimeIndex(impacts - 1)]);
      box.high.push_back(scene_.duration);
      Bound(std::move(child));
    }
  }

  // Whether the last repetition of impact i is in the sequence itself.
  static bool HasLast(const ImpactBox& box, int i) {
    const int end = box.EndOfRepetition(i);
    return end < static_cast<int>(box.sequence.size()) && box.sequence[end] == box.sequence[i];
  }

  // Divides the motions of impact i, which may be repeated: it is not; or its last repetition enters the sequence, with
  // others in between; or, if that is in the sequence, the first one of these.
  bool Unfold(const Node& node, int i) {
    const Candidate pair = node.box.sequence[i];
    if (node.box.num_parameters() + (pair.plane ? 1 : 2) > kMostParameters) return false;
    Node once = node;
    once.box.repeated[i] = false;
    Bound(once);
    const bool has_last = HasLast(node.box, i) || !pair.plane;
    const int end = node.box.EndOfRepetition(i);
    for (int at = i + 1; at <= end; ++at) {  // where the other one stands
      for (int quarter = 0; quarter < (pair.plane ? 1 : kQuarters); ++quarter) {
        Node twice = node;
        ImpactBox& box = twice.box;
        const int parameter = box.TimeIndex(at);
        const double begin = box.low[box.TimeIndex(i)];
        box.repeated[i] = !has_last;
        box.sequence.insert(box.sequence.begin() + at, pair);
        box.quarters.insert(box.quarters.begin() + at, quarter);
        box.repeated.insert(box.repeated.begin() + at, has_last);
        if (!pair.plane) {
          box.low.insert(box.low.begin() + parameter, -kLargestTau);
          box.high.insert(box.high.begin() + parameter, kLargestTau);
        }
        box.low.insert(box.low.begin() + parameter, begin);
        box.high.insert(box.high.begin() + parameter, scene_.duration);
        Bound(std::move(twice));
      }
    }
    return true;
  }

  void Halve(const Node& node) {
    const int j = node.split;
    const double middle = j < 0 ? 0 : 0.5 * (node.box.low[j] + node.box.high[j]);
    if (j < 0 || !(node.box.low[j] < middle && middle < node.box.high[j])) {
      return node.is_cut ? Bound(node, node.multipliers.get()) : Finish(node);
    }
    Node lower = node, upper = node;
    lower.box.high[j] = middle;
    upper.box.low[j] = middle;
    Bound(std::move(lower), node.multipliers.get());
    Bound(std::move(upper), node.multipliers.get());
  }

  // Cuts off the part of a box that is not in the order of time. Returns false if nothing remains.
  static bool Order(ImpactBox* box) {
    const int impacts = static_cast<int>(box->sequence.size());
    for (int i = 1; i < impacts; ++i) {
      const int before = box->TimeIndex(i - 1), at = box->TimeIndex(i);
      box->low[at] = std::max(box->low[at], box->low[before]);
    }
    for (int i = impacts - 2; i >= 0; --i) {
      const int at = box->TimeIndex(i), after = box->TimeIndex(i + 1);
      box->high[at] = std::min(box->high[at], box->high[after]);
    }
    for (int j = 0; j < box->num_parameters(); ++j) {
      if (box->low[j] > box->high[j]) return false;
    }
    return true;
  }

  // `known` has the multipliers of a box around this one, or is null.
  void Bound(Node node, const Multipliers* known = nullptr) {
    if (!Order(&node.box)) return;
    ++out_.boxes;
    BoxBound bound = relaxation_.Bound(node.box, wanted_, known);
    if (bound.lower_outside < out_.upper) {
      Node outside = node;
      outside.lower = std::max(node.lower, bound.lower_outside);
      Finish(std::move(outside));
    }
    node.is_cut = node.box.low != bound.low || node.box.high != bound.high;
    node.box.low = std::move(bound.low);
    node.box.high = std::move(bound.high);
    node.lower = std::max(node.lower, bound.lower);
    node.own = bound.lower;
    node.at_middle = bound.at_middle;
    node.least = bound.least;
    node.split = bound.split;
    node.multipliers = std::move(bound.multipliers);
    if (node.lower >= out_.upper) {
      Count(node, &excluded_);
    } else if (node.lower >= wanted_) {
      Finish(node);
    } else {
      Push(std::move(node));
    }
  }

  void Finish(const Node& node) {
    final_lowest_ = std::min(final_lowest_, node.lower);
    Count(node, &final_);
  }

  using Key = std::vector<int>;
  static Key KeyOf(const ImpactBox& box) {
    Key key{box.open ? 1 : 0, box.free_normal ? 1 : 0};
    for (size_t i = 0; i < box.sequence.size(); ++i) {
      const Candidate& pair = box.sequence[i];
      key.insert(key.end(), {pair.a, pair.b, pair.plane ? 1 : 0, box.repeated[i]});
    }
    return key;
  }
  static void Count(const Node& node, std::map<Key, SequenceBound>* bounds) {
    SequenceBound& bound = (*bounds)[KeyOf(node.box)];
    if (bound.boxes == 0) {
      bound = {node.box.sequence, node.box.repeated, node.box.open, node.lower, 0};
    }
    bound.lower = std::min(bound.lower, node.lower);
    ++bound.boxes;
  }
  static std::vector<SequenceBound> Sorted(const std::map<Key, SequenceBound>& bounds) {
    std::vector<SequenceBound> sorted;
    for (const auto& [key, bound] : bounds) sorted.push_back(bound);
    std::stable_sort(
        sorted.begin(), sorted.end(), [](const SequenceBound& a, const SequenceBound& b) { return a.lower < b.lower; });
    return sorted;
  }

  void Report() {
    std::map<Key, SequenceBound> left = final_;
    for (const Node& node : queue_) Count(node, &left);
    out_.left = Sorted(left);
    out_.excluded = Sorted(excluded_);
  }

  const Scene& scene_;
  const GlobalOptions& options_;
  const Relaxation relaxation_;
  const ContactSequence pairs_;
  std::vector<bool> pushed_, aimed_;  // by disc
  const double wanted_;               // boxes with bounds as high are not divided any more
  const std::clock_t start_;
  double first_gap_ = 0;                                           // between `wanted_` and the bound of all motions
  std::vector<Node> queue_;                                        // a heap
  std::map<Key, SequenceBound> excluded_, final_;                  // final: boxes that are not divided any more
  double final_lowest_ = std::numeric_limits<double>::infinity();  // of their bounds
  std::size_t bytes_ = 0, next_check_ = 0;
  GlobalBound out_;
};

}  // namespace

std::string UnsupportedByGlobalBound(const Scene& scene) {
  if (scene.optimize != Optimize::kControl) return "the global bound needs a scene whose control is optimized";
  if (!scene.design.empty()) return "the global bound does not support design parameters";
  if (std::string found = NonBallisticFeatures(scene); !found.empty()) {
    return "the global bound supports discs and planes only; the scene has " + found;
  }
  if (HasFriction(scene)) return "the global bound supports contacts without friction only";
  if (!(scene.objective.effort > 0)) return "the global bound needs an effort above 0";
  Scene without_bounds = scene;  // the relaxation has bounds on forces
  without_bounds.control.max.clear();
  without_bounds.control.max_norm.clear();
  if (std::string found = NonTerminalFeatures(without_bounds); !found.empty()) {
    return "the global bound supports terminal costs and effort only; the scene has " + found;
  }
  for (const TerminalTerm& term : scene.objective.terminal) {
    if (term.component) return "the global bound supports quadratic terminal costs only; the scene has a linear one";
  }
  return "";
}

GlobalBound BoundGlobally(const Scene& scene, double upper, const GlobalOptions& options) {
  return BranchAndBound(scene, upper, options).Run();
}

}  // namespace saltus
