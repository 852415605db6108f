#include "saltus/audit/audit.h"

#include <glog/logging.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>

#include "audit/gradient/step_study.h"
#include "base/number_text.h"
#include "base/statistics.h"
#include "exact/closed_forms.h"
#include "saltus/scene/materials.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/simulate/registry.h"
#include "scene/units.h"

namespace saltus {
namespace {

// Returns all entries of the gradient, scaled to the unit of derivatives by position.
Eigen::VectorXd Stack(const ModelGradient& gradient, int intervals) {
  const double time = gradient.duration;
  std::vector<double> all = gradient.gradient.initial;
  const size_t moves = gradient.spins ? all.size() / (4 + kSpin) * 4 : all.size();
  for (size_t i = 0; i < moves; ++i) all[i] /= i % 4 < 2 ? 1 : time;
  for (size_t i = moves; i < all.size(); ++i) all[i] /= gradient.length * (i % kSpin == 0 ? 1 : time);
  for (double entry : CoarsenControl(gradient.gradient.control, gradient.num_steps, intervals)) {
    all.push_back(entry * gradient.mass / (time * time));
  }
  return Eigen::Map<Eigen::VectorXd>(all.data(), all.size());
}

ModelGradient ClosedFormGradient(const ClosedForm& closed_form, const Scene& scene) {
  ModelGradient gradient;
  gradient.contact = "closed form";
  gradient.num_steps = scene.steps;
  SetScales(scene, &gradient);
  gradient.loss = closed_form.loss;
  for (int i = 0; i < scene.num_bodies(); ++i) {
    const Vec2d& p = closed_form.gradient.position[i];
    const Vec2d& v = closed_form.gradient.velocity[i];
    gradient.gradient.initial.insert(gradient.gradient.initial.end(), {p[0], p[1], v[0], v[1]});
  }
  for (const std::vector<Vec2d>& forces : closed_form.gradient.control) {
    for (const Vec2d& force : forces)
      gradient.gradient.control.insert(gradient.gradient.control.end(), {force[0], force[1]});
  }
  gradient.gradient.parameters.restitution = closed_form.gradient.restitution;
  gradient.gradient.parameters.friction = closed_form.gradient.friction;
  for (const ExactEvent& event : closed_form.events) {
    gradient.events.push_back({event.time, event.a, event.b, static_cast<ContactMode>(event.mode)});
  }
  return gradient;
}

// Sums up (value - exact)^2 in units of the standard error. Entries up to `rounding` are taken for 0.
struct SquaredDeviation {
  double rounding = 0;
  double sum = 0;
  int count = 0;
  void Add(double difference, double standard_error) {
    if (std::abs(difference) <= rounding && standard_error <= rounding) return;
    sum += std::pow(difference / standard_error, 2);
    ++count;
  }
};

double Rounding(const std::vector<double>& values) { return 1e-12 * Largest(values); }

// Returns the distance of an estimate in standard errors. The control is compared by segments, over which entries of
// the estimate are equal; if its grid is finer than that of the exact gradient, it is not compared.
double DeviationInStandardErrors(const ModelGradient& estimate, const ModelGradient& exact) {
  SquaredDeviation deviation{.rounding = Rounding(exact.gradient.initial)};
  for (size_t i = 0; i < estimate.initial_error.size(); ++i) {
    deviation.Add(estimate.gradient.initial[i] - exact.gradient.initial[i], estimate.initial_error[i]);
  }
  const auto root_mean = [&] { return deviation.count > 0 ? std::sqrt(deviation.sum / deviation.count) : 0.0; };
  if (estimate.control_error.empty() || exact.num_steps < estimate.num_steps) return root_mean();
  const std::vector<double> control = CoarsenControl(exact.gradient.control, exact.num_steps, estimate.num_steps);
  const std::int64_t steps = estimate.num_steps, width = static_cast<std::int64_t>(control.size()) / steps;
  const bool in_segments =
      estimate.surrogate->kind == SurrogateKind::kSmoothedZeroth && estimate.surrogate->segments > 0;
  const std::int64_t segments = in_segments ? estimate.surrogate->segments : steps;
  deviation.rounding = Rounding(control) * static_cast<double>(steps) / static_cast<double>(segments);
  for (std::int64_t j = 0; j < width; ++j) {
    double difference = 0, error = 0;
    for (std::int64_t k = 0; k < steps; ++k) {
      const std::int64_t i = k * width + j;
      difference += estimate.gradient.control[i] - control[i];
      error += estimate.control_error[i];
      if (k + 1 < steps && (k + 1) * segments / steps == k * segments / steps) continue;
      deviation.Add(difference, error);
      difference = error = 0;
    }
  }
  return root_mean();
}

// Describes a surrogate gradient, and its distance from the exact gradient.
std::string DescribeSurrogate(const ModelAudit& audit) {
  const Surrogate& surrogate = *audit.gradient.surrogate;
  std::string why = "contact modes that leave a larger gradient";
  if (surrogate.smooths()) {
    why = "mean of " + std::to_string(surrogate.samples) + " samples with sigma " + ToText(surrogate.sigma, 6) +
          ", seed " + std::to_string(surrogate.seed);
  }
  if (!audit.error || !audit.error->in_standard_errors) return why;
  // Samples of a loss that is linear in an entry are all the same.
  if (std::isinf(*audit.error->in_standard_errors)) {
    return why + "; wrong in an entry on which all samples agree, so that no standard error measures the distance";
  }
  return why + "; " + ToText(*audit.error->in_standard_errors, 3) + " standard errors from the exact gradient";
}

// Whether the published derivative of the model differs from that of its steps by design.
bool IsNotMeantAsDerivative(const Contact& contact) {
  return FindContactModel(contact)->published_jacobian || HasBiasedDerivative(contact);
}

// Returns the reason why the gradient is not right.
std::string CauseOf(const ModelAudit& audit) {
  const std::string too_few_steps = "the error falls, but not yet below one percent: begin with more steps (--steps)";
  // Without a study, the first remark about a black box is the reason.
  const bool studied = audit.refinement || audit.widths;
  if (audit.black_box && !studied && !audit.black_box->remarks.empty()) return audit.black_box->remarks.front();
  if (audit.verdict == Verdict::kIllConditioned) {
    return audit.refinement->conditioning->Describe();
  }
  // These are deviations of the motion itself, which linearizations of contacts do not show.
  const std::optional<ContactRecognition>& recognition = audit.recognition;
  if (recognition && (recognition->contact_class == ContactClass::kNoRestitution ||
                      recognition->contact_class == ContactClass::kDepthFeedback)) {
    return recognition->words;
  }
  if (audit.verdict == Verdict::kUnknown && audit.refinement && audit.refinement->ok()) {
    const bool clear = recognition && recognition->contact_class != ContactClass::kUnclear;
    return too_few_steps + (clear ? "; contact is " + recognition->words : "");
  }
  const bool jumps = recognition && recognition->contact_class == ContactClass::kForceWithJump;
  if (const ContactError* first = audit.FirstWrong()) {
    return first->cause + (jumps ? "; its force jumps at the onset" : "");
  }
  if (audit.attribution && !audit.attribution->sequence.empty()) return audit.attribution->sequence;
  if (audit.attribution && !audit.attribution->ok()) return audit.attribution->reason;
  if (audit.attribution && !audit.attribution->limit.empty()) {
    return "not traced to a contact in time: " + audit.attribution->limit;
  }
  if (audit.attribution) return "no single contact is wrong";
  if (audit.black_box && recognition && recognition->contact_class != ContactClass::kUnclear) {
    return recognition->words + (audit.widths ? "; " + audit.widths->Summary() : "");
  }
  if (audit.widths) return audit.widths->Summary();
  if (!audit.refinement) return "";
  return audit.refinement->ok() ? too_few_steps : audit.refinement->reason;
}

}  // namespace

std::vector<double> CoarsenControl(const std::vector<double>& control, int steps, int intervals) {
  CHECK_GT(intervals, 0);
  CHECK_EQ(steps % intervals, 0);
  CHECK(steps > 0 ? control.size() % steps == 0 : control.empty());
  const size_t width = steps > 0 ? control.size() / steps : 0;
  std::vector<double> coarse(width * intervals, 0.0);
  for (size_t i = 0; i < control.size(); ++i) {
    const size_t step = i / width;
    coarse[step / (steps / intervals) * width + i % width] += control[i];
  }
  return coarse;
}

GradientError CompareGradients(const ModelGradient& gradient, const ModelGradient& exact) {
  CHECK(gradient.ok() && exact.ok());
  const int intervals = std::min(gradient.num_steps, exact.num_steps);
  Eigen::VectorXd g = Stack(gradient, intervals);
  Eigen::VectorXd reference = Stack(exact, intervals);
  CHECK_EQ(g.size(), reference.size()) << "the gradients are of different scenes";
  for (const OneSided& entry : exact.one_sided) {
    const int at = 4 * entry.body + (entry.quantity == OneSided::Quantity::kVelocity ? 2 : 0) + entry.component;
    g[at] = reference[at] = 0;
  }
  const double scale = reference.norm();
  GradientError error;
  error.relative = (g - reference).norm() / (scale > 0 ? scale : exact.loss_scale);
  const double cosine = g.dot(reference) / (g.norm() * scale);
  error.angle = std::isfinite(cosine) ? std::acos(std::clamp(cosine, -1.0, 1.0)) : 0.0;
  if (!gradient.initial_error.empty()) error.in_standard_errors = DeviationInStandardErrors(gradient, exact);
  return error;
}

std::optional<ModelGradient> ComputeExactGradient(const Scene& scene, const StopRequest& stop) {
  if (const ModelTraits* model = ExactModel()) {
    ModelGradient exact = ComputeGradient(model->name, scene, Precision::kDouble, stop, nullptr, /*with_grazes=*/true);
    if (exact.ok() && exact.unresolved_steps == 0) {
      if (!exact.ambiguous.empty()) {
        const ExactRun run = SimulateExactly(scene, InitialState(scene), InitialControl(scene, scene.steps), {}, stop);
        if (run.reason == kStopped) return exact;  // whether the order of ties decides is not known
        exact.ambiguous = run.ambiguous;
        exact.spread = run.spread;
      }
      if (exact.ambiguous.empty()) {
        const Scene natural = ToNaturalUnits(scene);
        for (const OneSided& entry : OneSidedBySimultaneousEvents(model->name, natural, exact.one_sided, stop)) {
          exact.one_sided.push_back(entry);
        }
      }
      return exact;
    }
  }
  if (stop && stop()) return std::nullopt;
  if (const std::optional<ClosedForm> closed_form = EvaluateClosedForm(scene))
    return ClosedFormGradient(*closed_form, scene);
  return std::nullopt;
}

const ContactError* ModelAudit::FirstWrong() const {
  if (!attribution || attribution->first_wrong < 0) return nullptr;
  return &attribution->contacts[attribution->first_wrong];
}

bool ModelAudit::ContradictsItself() const {
  return black_box && black_box->own_gradient && gradient_check && gradient_check->agreement == Agreement::kDiffers;
}

std::string ModelAudit::VerdictReason() const {
  const bool resolved = gradient.unresolved_steps == 0;
  if (resolved && (verdict == Verdict::kRight || verdict == Verdict::kConsistent)) return "";
  if (verdict == Verdict::kBiased) return DescribeSurrogate(*this);
  if (interrupted) return "interrupted";
  if (verdict == Verdict::kNotApplicable) return not_comparable;
  if (verdict == Verdict::kAmbiguous) return DescribeTies(ambiguous, spread);
  if (verdict == Verdict::kOneSided)
    return "the loss has a kink: derivatives by the initial state are one-sided or do not exist";
  if (!resolved) return DescribeUnresolved(gradient.unresolved_steps, gradient.num_steps);
  const std::string cause = CauseOf(*this);
  if (verdict == Verdict::kIllConditioned) return cause;  // nor can differences of its loss be compared
  if (ContradictsItself()) {
    return "its gradient contradicts its own simulator: along a direction by " +
           std::string(QuantityToString(gradient_check->quantity)) + " it is " + ToText(gradient_check->gradient, 4) +
           ", differences of its loss give " + ToText(gradient_check->difference, 4) +
           "; correct the derivative first" + (cause.empty() ? "" : "; " + cause);
  }
  if (!gradient_check || gradient_check->agreement != Agreement::kDiffers ||
      (!black_box && IsNotMeantAsDerivative(gradient.contact))) {
    return cause;
  }
  return (cause.empty() ? "" : cause + "; ") + "agrees with no differences of its own loss";
}

std::string ReasonNotComparable(const Contact& contact, const Scene& scene) {
  const ModelTraits* traits = FindContactModel(contact);
  const bool spins = traits != nullptr && traits->spins && HasFriction(scene) && !scene.Spins();
  return spins ? "friction spins the discs of this model; those of the exact gradient do not spin" : "";
}

ModelAudit AuditModel(const Contact& contact, const Scene& scene, Precision precision,
                      const std::optional<ModelGradient>& reference, const AuditOptions& options) {
  const StopRequest& stop = options.stop;
  const auto threads = [&] { return options.threads_now ? options.threads_now() : options.threads; };
  ModelAudit audit;
  const auto interrupted = [&] { return audit.interrupted = stop && stop(); };
  // A study that was stopped is dropped.
  const auto keep = [&](auto found, auto* kept) {
    if (interrupted()) return false;
    *kept = std::move(found);
    return true;
  };
  audit.gradient = options.surrogate ? ComputeSurrogate(contact, scene, precision, *options.surrogate, threads(), stop)
                                     : ComputeGradient(contact, scene, precision, stop);
  if (!audit.gradient.ok()) {
    audit.interrupted = audit.gradient.reason == kStopped;
    return audit;
  }
  if (reference && !reference->ambiguous.empty()) {
    audit.verdict = Verdict::kAmbiguous;
    audit.ambiguous = reference->ambiguous;
    audit.spread = reference->spread;
    if (options.width_sweep) keep(SweepWidths(contact, scene, options.widths, stop), &audit.widths);
    return audit;
  }
  if (options.surrogate) {
    if (reference) audit.error = CompareGradients(audit.gradient, *reference);
    audit.verdict = Verdict::kBiased;
    return audit;
  }
  const ModelTraits* traits = FindContactModel(contact);
  if (reference && traits != nullptr && traits->event_driven) audit.gradient.one_sided = reference->one_sided;
  if (!keep(RecogniseContact(contact, scene, stop), &audit.recognition)) return audit;
  if (!keep(CheckGradient(contact, scene, stop, threads()), &audit.gradient_check)) return audit;
  if (options.refinement.parameters) {
    audit.parameters = CompareParameters(contact, scene, ParametersToCompare(scene), stop);
    if (interrupted()) return audit;
  }
  if (reference) audit.not_comparable = ReasonNotComparable(contact, scene);
  if (!audit.not_comparable.empty()) {
    audit.verdict = Verdict::kNotApplicable;
  } else if (reference) {
    audit.error = CompareGradients(audit.gradient, *reference);
    RefinementOptions refinement_options = options.refinement;
    refinement_options.threads = options.threads;
    refinement_options.threads_now = options.threads_now;
    if (!keep(StudyRefinement(contact, scene, refinement_options, stop), &audit.refinement)) return audit;
    audit.verdict = audit.refinement->verdict;
    if (options.attribution && IsWrong(audit.verdict)) {
      const AttributionOptions attribution{stop, options.attribution_seconds, options.status, threads()};
      if (!keep(AttributeError(contact, scene, attribution), &audit.attribution)) return audit;
    }
  }
  if (options.width_sweep || !reference) {
    if (!keep(SweepWidths(contact, scene, options.widths, stop), &audit.widths)) return audit;
    if (reference) CompareWithExact(scene, *reference, &*audit.widths);
    if (!reference) audit.verdict = audit.widths->verdict;
  }
  return audit;
}

}  // namespace saltus
