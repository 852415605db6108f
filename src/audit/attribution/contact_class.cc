#include "saltus/audit/contact_class.h"

#include <glog/logging.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "audit/attribution/contact_run.h"
#include "base/number_text.h"
#include "base/statistics.h"
#include "saltus/control/contact_sequence.h"
#include "saltus/scene/materials.h"
#include "saltus/scene/walls.h"
#include "scene/units.h"

namespace saltus {
namespace {

// Lengths of a step: three to each halving, from the model's own step to one 256 times finer. Finer ones are tried only
// for a contact that is not an impulse at that length.
constexpr int kPerHalving = 3;
constexpr int kHalvings = 8, kMostHalvings = 16;
constexpr int kReboundHalvings = 4;
constexpr size_t kNeighbours = kPerHalving;

// The concentration (largest share of a step) is above kImpulse for an impulse, and below kForce for a resolved force.
constexpr double kImpulse = 0.4, kForce = 0.1, kResolved = 0.02;
// A smaller rebound, relative to the scene's restitution, counts as none. A critically damped spring keeps 0.135.
constexpr double kNoRebound = 0.15;
// A larger rebound, whatever the restitution, shows that something else took part.
constexpr double kMostRebound = 1.25;
// Orders in h below which a force jumps at its onset, and above which it is continuous.
constexpr double kJumps = 1.35, kContinuous = 1.65;
constexpr double kOnsetSteps = 3000;  // of the whole contact, at the finest length at which its onset is seen
constexpr double kTolerance = 0.1;    // of dx'/dx
constexpr double kFeedback = 0.01;    // h dv'/dx above which it is one
constexpr size_t kFinest = 3 * kPerHalving;

struct Length {
  double h = 0;
  ContactRun run;
};

// Returns the median of `value` over `count` entries from `first` on, counted from the end if `first` is negative.
template <typename T, typename Value>
double MedianOf(const std::vector<T>& all, int first, size_t count, const Value& value) {
  const size_t begin = first < 0 ? all.size() - std::min<size_t>(all.size(), -first) : first;
  std::vector<double> values;
  for (size_t i = begin; i < std::min(all.size(), begin + count); ++i) values.push_back(value(all[i]));
  return Median(values);
}

// Returns the exponent p of value ~ h^p, by least squares over the last `count` entries.
template <typename T, typename Value>
double OrderOf(const std::vector<T>& all, size_t count, const Value& value) {
  std::vector<double> lengths, values;
  for (size_t i = all.size() - std::min(all.size(), count); i < all.size(); ++i) {
    lengths.push_back(all[i].h);
    values.push_back(std::max(value(all[i]), 1e-300));
  }
  return FittedExponent(lengths, values);
}

class Recogniser {
 public:
  Recogniser(const ContactBench& bench, double h, std::vector<double> before, double restitution)
      : bench_(bench), h_(h), before_(std::move(before)) {
    out_.restitution = restitution;
  }

  ContactRecognition Run() {
    if (!RunContacts()) return out_;
    RecordContacts();
    if (std::max(*out_.rebound, *out_.finer_rebound) < kNoRebound * out_.restitution) {
      Decide(ContactClass::kNoRestitution,
             FormatNumbers("rebounds at %.3f of the closing speed, at finer steps %.3f, where %.2f is asked for",
                           *out_.rebound,
                           *out_.finer_rebound,
                           out_.restitution));
    } else if (*out_.finer_rebound > kMostRebound) {
      out_.words = FormatNumbers("separates at %.2f of the closing speed: another contact or force takes part",
                                 *out_.finer_rebound);
    } else if (*out_.finer_concentration < kForce) {
      JudgeForce();
    } else if (*out_.finer_concentration > kImpulse) {
      JudgeImpulse();
    } else {
      out_.words = FormatNumbers("between impulse and force: the largest change in a step is %.2f of all",
                                 *out_.finer_concentration);
    }
    return out_;
  }

 private:
  double LengthOf(int i) const { return h_ * std::exp2(-static_cast<double>(i) / kPerHalving); }
  // Runs the contact until it is clear whether it is an impulse. Returns false, with a reason, if that is not clear.
  bool RunContacts() {
    std::vector<double> from = before_;
    int steps = 0;
    for (int i = 0; i <= kMostHalvings * kPerHalving && steps < bench_.MostSteps(); ++i) {
      const ContactRun run = bench_.Run(LengthOf(i), from, /*onset_only=*/false);
      if (!run.begins) {
        out_.words = "the contact does not happen at every length of step";
        return false;
      }
      lengths_.push_back({LengthOf(i), run});
      from = run.before;
      steps += run.steps;
      if (lengths_.size() < 2 * kNeighbours) continue;
      const double concentration = FinestConcentration();
      if (concentration < kResolved || (i >= kHalvings * kPerHalving && concentration > kImpulse)) break;
    }
    if (lengths_.size() >= 2 * kNeighbours) return true;
    out_.words = FormatNumbers("the contact is not over after %.0f steps", static_cast<double>(steps));
    return false;
  }

  double FinestConcentration() const {
    return MedianOf(lengths_, -int(kNeighbours), kNeighbours, [](const Length& l) { return l.run.concentration; });
  }
  void RecordContacts() {
    const auto rebound = [](const Length& length) { return length.run.rebound; };
    out_.concentration =
        MedianOf(lengths_, 0, kNeighbours, [](const Length& length) { return length.run.concentration; });
    out_.finer_concentration = FinestConcentration();
    out_.rebound = MedianOf(lengths_, 0, kNeighbours, rebound);
    const int last = std::min<int>(lengths_.size(), kReboundHalvings * kPerHalving);
    out_.finer_rebound = MedianOf(lengths_, std::max<int>(0, last - kNeighbours), kNeighbours, rebound);
  }

  void JudgeForce() {
    std::vector<Length> onsets = lengths_;
    const double halvings = std::log2(kOnsetSteps / std::max(1, onsets.back().run.touched));
    const int last = static_cast<int>(onsets.size() + kPerHalving * std::max(2.0, halvings));
    for (int i = static_cast<int>(onsets.size()); i <= last; ++i) {
      const ContactRun run = bench_.Run(LengthOf(i), onsets.back().run.before, /*onset_only=*/true);
      if (!run.begins) break;
      onsets.push_back({LengthOf(i), run});
    }
    const double order =
        OrderOf(onsets, 2 * kPerHalving + 1, [](const Length& length) { return length.run.first_full; });
    out_.onset_order = order;
    const std::string found = FormatNumbers("a force, at its onset ~ h^%.1f in a step", order);
    if (order < kJumps) {
      Decide(ContactClass::kForceWithJump, found + FormatNumbers("; rebound %.2f", *out_.finer_rebound));
    } else if (order > kContinuous) {
      Decide(ContactClass::kContinuousForce, found + FormatNumbers("; rebound %.2f", *out_.finer_rebound));
    } else {
      Decide(ContactClass::kUnclear, found + ", between that of a jump and of a continuous one");
    }
  }

  void JudgeImpulse() {
    struct Entry {
      double h, position, velocity;
    };
    std::vector<Entry> entries;
    for (size_t i = lengths_.size() - std::min(lengths_.size(), kFinest); i < lengths_.size(); ++i) {
      const NormalMap map = bench_.Linearize(lengths_[i].h, lengths_[i].run.before_largest);
      entries.push_back({lengths_[i].h, map.position_from_position, lengths_[i].h * map.velocity_from_position});
    }
    double position = MedianOf(entries, 0, kFinest, [](const Entry& e) { return e.position; });
    if (std::abs(position) < 0.005) position = 0;  // not to be printed as -0.00
    const double feedback = MedianOf(entries, 0, kFinest, [](const Entry& e) { return e.velocity; });
    const double order = OrderOf(entries, kFinest, [](const Entry& e) { return std::abs(e.velocity); });
    out_.position_from_position = position;
    out_.velocity_from_position = feedback;
    const auto near = [](double value, double target) { return std::abs(value - target) < kTolerance; };
    const std::string passes = FormatNumbers("an impulse; the normal position passes with a factor of %.2f", position);
    const std::string instead = FormatNumbers(" instead of %.2f", -out_.restitution);
    const bool rebounds = *out_.finer_rebound > 2 * kTolerance;
    if (near(position, 0) && rebounds) {
      Decide(ContactClass::kProjection, passes + instead);
    } else if (near(position, -*out_.finer_rebound) && rebounds) {
      Decide(ContactClass::kImpactTimeResolved, passes);
    } else if (std::abs(position - 1) < kTolerance + std::abs(feedback) && std::abs(feedback) > kFeedback) {
      // The impulse may have acted within the step, and then has changed the position too.
      if (std::abs(order) < 0.5) {
        Decide(ContactClass::kDepthFeedback,
               FormatNumbers("an impulse that takes %.2g of the depth out in a step", -feedback));
      } else {
        Decide(ContactClass::kUnclear, passes + ", and its dependence on the depth is that of no class");
      }
    } else if (near(position, 1)) {
      Decide(ContactClass::kImpulseAtStepBoundary, passes + instead);
    } else {
      Decide(ContactClass::kUnclear, passes + instead + ", which is that of no known class");
    }
  }

  void Decide(ContactClass contact_class, std::string words) {
    out_.contact_class = contact_class;
    out_.words = std::move(words);
  }

  const ContactBench& bench_;
  double h_;
  std::vector<double> before_;
  std::vector<Length> lengths_;  // from the model's own on
  ContactRecognition out_;
};

}  // namespace

ContactRecognition RecogniseOnBench(const ContactBench& bench, double h, std::vector<double> before,
                                    double restitution) {
  return Recogniser(bench, h, std::move(before), restitution).Run();
}

const char* ContactClassToString(ContactClass contact_class) {
  constexpr const char* kNames[] = {"unclear",
                                    "impact time resolved",
                                    "impulse at a step boundary",
                                    "projection",
                                    "depth feedback",
                                    "continuous force",
                                    "force with a jump",
                                    "no restitution"};
  return kNames[static_cast<int>(contact_class)];
}

const char* MeaningOf(ContactClass contact_class) {
  constexpr const char* kMeanings[] = {
      "The numbers do not decide.",
      "An impulse that is differentiated together with its time: a displacement towards the contact comes back "
      "with the opposite sign, as it should.",
      "An impulse that acts at the boundary of a step, whatever the depth: the motion converges, but its time "
      "of impact is not differentiated, and the gradient by position keeps the wrong sign at every step.",
      "Overlap is projected away: whatever the normal position was before the impact, nothing of it is left in "
      "the gradient.",
      "The impulse corrects a part of the depth within a step: as the depth is a part of what a step moves, the "
      "gradient grows without bound as steps shrink.",
      "A force that sets in from zero: the gradient converges to the exact one as first the step and then the "
      "softness go to zero.",
      "A force that jumps at its onset: what the jump puts into the gradient does not depend on the step, and "
      "grows with stiffness and damping.",
      "Plastic by construction: the gradient is that of a motion that does not rebound."};
  return kMeanings[static_cast<int>(contact_class)];
}

ContactRecognition RecogniseContact(const Contact& contact, const Scene& scene, const StopRequest& stop) {
  ContactRecognition refused;
  refused.words = ReasonNotApplicable(contact, scene);
  if (!refused.words.empty()) return refused;
  if (const std::string beyond = NonBallisticForces(scene); !beyond.empty()) {
    refused.words = "the scene has " + beyond + ", and contacts are looked at beside flights of constant acceleration";
    return refused;
  }
  const Scene natural = ToNaturalUnits(scene);
  const std::optional<Encounter> encounter = FindEncounter(contact, natural, stop);
  if (!encounter) {
    refused.restitution = natural.contact.restitution;
    refused.words = "no two bodies meet by themselves";
    return refused;
  }
  const double h = natural.duration / (natural.steps / CHECK_NOTNULL(FindContactModel(contact))->grid_steps);
  const Candidate& pair = encounter->pair;
  const int other = pair.plane ? WallPartsOf(natural)[pair.b].wall.material - 1 : natural.bodies[pair.b].material;
  const double restitution = ContactBetween(natural, natural.bodies[pair.a].material, other).restitution;
  ContactRecognition found =
      RecogniseOnBench(ModelBench(contact, natural, *encounter, stop), h, encounter->before, restitution);
  found.step = encounter->step;
  found.a = natural.bodies[pair.a].name;
  found.b = pair.plane ? WallNamesOf(natural)[pair.b] : natural.bodies[pair.b].name;
  return found;
}

}  // namespace saltus
