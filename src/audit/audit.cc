#include "saltus/audit/audit.h"

#include <glog/logging.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numeric>

#include "saltus/dynamics/registry.h"
#include "saltus/exact/closed_forms.h"

namespace saltus {
namespace {

Eigen::VectorXd Stack(const ModelGradient& gradient, int intervals) {
  std::vector<double> all = gradient.gradient.initial;
  const std::vector<double> control = CoarsenControl(gradient.gradient.control, gradient.num_steps, intervals);
  all.insert(all.end(), control.begin(), control.end());
  return Eigen::Map<Eigen::VectorXd>(all.data(), all.size());
}

ModelGradient FromClosedForm(const ClosedForm& closed_form, const Scene& scene) {
  ModelGradient gradient;
  gradient.contact = "closed form";
  gradient.num_steps = scene.steps;
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

// Adds (value - exact)^2 in units of the standard error.
struct SquaredDeviation {
  double sum = 0;
  int count = 0;
  void Add(double difference, double standard_error) {
    if (difference == 0 && standard_error == 0) return;
    sum += std::pow(difference / standard_error, 2);
    ++count;
  }
  double RootMean() const { return count > 0 ? std::sqrt(sum / count) : 0.0; }
};

// The control of an estimate is compared by segments, within which its entries are one number; if its grid is finer
// than the exact one's, not at all.
double DeviationInStandardErrors(const ModelGradient& estimate, const ModelGradient& exact) {
  SquaredDeviation deviation;
  for (size_t i = 0; i < estimate.initial_error.size(); ++i) {
    deviation.Add(estimate.gradient.initial[i] - exact.gradient.initial[i], estimate.initial_error[i]);
  }
  if (estimate.control_error.empty() || exact.num_steps < estimate.num_steps) return deviation.RootMean();
  const std::vector<double> control = CoarsenControl(exact.gradient.control, exact.num_steps, estimate.num_steps);
  const std::int64_t steps = estimate.num_steps, width = static_cast<std::int64_t>(control.size()) / steps;
  const bool in_segments =
      estimate.surrogate->kind == SurrogateKind::kSmoothedZeroth && estimate.surrogate->segments > 0;
  const std::int64_t segments = in_segments ? estimate.surrogate->segments : steps;
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
  return deviation.RootMean();
}

// What a surrogate is, and how far from the exact gradient.
std::string DescribeSurrogate(const ModelAudit& audit) {
  const Surrogate& surrogate = *audit.gradient.surrogate;
  char text[160] = "";
  if (surrogate.smooths()) {
    std::snprintf(text,
                  sizeof text,
                  "mean of %d samples with sigma %g, seed %llu",
                  surrogate.samples,
                  surrogate.sigma,
                  static_cast<unsigned long long>(surrogate.seed));
  }
  std::string why = surrogate.smooths() ? text : "contact modes that the loss would rather have";
  if (audit.error && audit.error->in_standard_errors) {
    std::snprintf(
        text, sizeof text, "; %.3g standard errors from the exact gradient", *audit.error->in_standard_errors);
    why += text;
  }
  return why;
}

// What the derivative of its source is, and not of its steps.
bool IsNotMeantAsDerivative(std::string_view contact) {
  return FindContactModel(contact)->published_jacobian || HasBiasedDerivative(contact);
}

// Why the gradient is not right.
std::string CauseOf(const ModelAudit& audit) {
  if (audit.verdict == Verdict::kIllConditioned) {
    char text[160];
    std::snprintf(text,
                  sizeof text,
                  "rounding alone changes the exact gradient by %.2g of it (condition %.2g)",
                  audit.refinement->conditioning->rounding,
                  audit.refinement->conditioning->condition);
    return text;
  }
  // Deviations from the exact motion itself, of which the linearization of a contact knows nothing.
  const std::optional<ContactRecognition>& recognition = audit.recognition;
  if (recognition && (recognition->contact_class == ContactClass::kNoRestitution ||
                      recognition->contact_class == ContactClass::kDepthFeedback)) {
    return recognition->words;
  }
  const bool jumps = recognition && recognition->contact_class == ContactClass::kForceWithJump;
  if (const ContactError* first = audit.FirstWrong()) {
    return first->why + (jumps ? "; its force jumps at the onset" : "");
  }
  if (audit.attribution && !audit.attribution->sequence.empty()) return audit.attribution->sequence;
  if (audit.attribution && !audit.attribution->ok()) return audit.attribution->reason;
  if (audit.attribution) return "no single contact is wrong";
  if (audit.widths) return audit.widths->Summary();
  if (!audit.refinement) return "";
  return audit.refinement->ok() ? "the error falls, but not yet below one percent" : audit.refinement->reason;
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
  const Eigen::VectorXd g = Stack(gradient, intervals);
  const Eigen::VectorXd reference = Stack(exact, intervals);
  CHECK_EQ(g.size(), reference.size()) << "the gradients are of different scenes";
  const double scale = reference.norm();
  GradientError error;
  error.relative = scale > 0 ? (g - reference).norm() / scale : (g - reference).norm();
  const double cosine = g.dot(reference) / (g.norm() * scale);
  error.angle = std::isfinite(cosine) ? std::acos(std::clamp(cosine, -1.0, 1.0)) : 0.0;
  if (!gradient.initial_error.empty()) error.in_standard_errors = DeviationInStandardErrors(gradient, exact);
  return error;
}

std::optional<ModelGradient> ExactGradientOf(const Scene& scene) {
  for (const ModelTraits& traits : AllContactModels()) {
    if (!traits.event_driven) continue;
    ModelGradient exact = ComputeGradient(traits.name, scene, Precision::kDouble);
    if (exact.ok()) return exact;
  }
  if (const std::optional<ClosedForm> closed_form = EvaluateClosedForm(scene))
    return FromClosedForm(*closed_form, scene);
  return std::nullopt;
}

const ContactError* ModelAudit::FirstWrong() const {
  if (!attribution || attribution->first_wrong < 0) return nullptr;
  return &attribution->contacts[attribution->first_wrong];
}

std::string ModelAudit::Why() const {
  if (verdict == Verdict::kRight || verdict == Verdict::kConsistent) return "";
  if (verdict == Verdict::kBiased) return DescribeSurrogate(*this);
  if (verdict == Verdict::kNotApplicable) return not_comparable;
  const std::string cause = CauseOf(*this);
  if (!own || own->agreement != Agreement::kDiffers || IsNotMeantAsDerivative(gradient.contact)) return cause;
  return (cause.empty() ? "" : cause + "; ") + "agrees with no differences of its own loss";
}

std::string WhyNotComparable(std::string_view contact, const Scene& scene) {
  const ModelTraits* traits = FindContactModel(contact);
  const bool spins = traits != nullptr && traits->spins && scene.contact.friction > 0;
  return spins ? "friction spins the discs of this model; those of the exact gradient do not spin" : "";
}

ModelAudit AuditModel(std::string_view contact, const Scene& scene, Precision precision,
                      const std::optional<ModelGradient>& reference, const AuditOptions& options) {
  ModelAudit audit;
  audit.gradient = options.surrogate ? ComputeSurrogate(contact, scene, precision, *options.surrogate, options.threads)
                                     : ComputeGradient(contact, scene, precision);
  if (!audit.gradient.ok()) return audit;
  if (options.surrogate) {
    if (reference) audit.error = CompareGradients(audit.gradient, *reference);
    audit.verdict = Verdict::kBiased;
    return audit;
  }
  audit.recognition = RecogniseContact(contact, scene);
  audit.own = CompareWithOwnDifferences(contact, scene);
  if (reference) audit.not_comparable = WhyNotComparable(contact, scene);
  if (!audit.not_comparable.empty()) {
    audit.verdict = Verdict::kNotApplicable;
  } else if (reference) {
    audit.error = CompareGradients(audit.gradient, *reference);
    audit.refinement = StudyRefinement(contact, scene, options.refinement);
    audit.verdict = audit.refinement->verdict;
    if (options.attribution && IsWrong(audit.verdict)) audit.attribution = AttributeError(contact, scene);
  }
  if (options.width_sweep || !reference) {
    audit.widths = SweepWidths(contact, scene, options.widths);
    if (!reference) audit.verdict = audit.widths->verdict;
  }
  return audit;
}

}  // namespace saltus
