// Identification of parameters of a scene from recordings of its motion, by nonlinear least squares through impacts.
//
//   min over parameters, and the initial state of each segment, of   sum over samples of 1/2 rho(|r|^2)
//   r = [(x(time) - position) / sigma, (v(time) - velocity) / sigma_velocity]     the latter where it was measured
//
// x(time) is the motion under a contact model. Derivatives are forward sensitivities of its steps, which with `event`
// are exact through every impact. Parameters with bounds are transformed, so that all iterates satisfy the bounds. The
// cost is discontinuous where the sequence of impacts changes; fits therefore begin with the part before most of the
// impacts, and from several starts, of which the best result is returned.
//
// The law of impact may be unknown, as a function with parameters such as a network (impact_law.h), and so may the
// event functions of planes (event_functions.h).
//
// A recording may be divided into segments, each with its own initial state. Long recordings need this, because after
// many impacts the motion depends on its initial state beyond the accuracy of measurements.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "saltus/contact/event_functions.h"
#include "saltus/contact/impact_law.h"
#include "saltus/identify/recording.h"
#include "saltus/scene/scene_parameter.h"
#include "saltus/simulate/registry.h"

namespace saltus {

// A number to identify: a parameter of a scene (scene_parameter.h), or a parameter of a law.
using Unknown = SceneParameter;
// Parses names separated by commas; "gravity" and "force.ball" are both components. Returns the unknowns, or the error
// with what was found and expected.
std::variant<std::vector<Unknown>, std::string> ParseUnknowns(std::string_view names, const Scene& scene);

// The loss rho of a sample: rho(s) = s, ceres::HuberLoss or ceres::CauchyLoss, with IdentifyOptions::loss_scale.
enum class RobustLoss { kNone, kHuber, kCauchy };

struct IdentifyOptions {
  RobustLoss loss = RobustLoss::kHuber;
  double loss_scale = 2;       // |r|, in sigmas, beyond which the weight of a sample decreases
  double segment = 0;          // length of the segments, s; 0: recordings are not divided
  bool initial_states = true;  // whether the initial states of measured discs are unknown; otherwise those of the scene
  int starts = 12;             // largest number of starts, >= 1
  double outlier = 4;          // |r|, in sigmas, beyond which a sample is an outlier
  int max_iterations = 100;    // of each fit
  // A law of impact, whose parameters are additional unknowns; with the contact model `event` only.
  std::optional<ImpactLaw> law = std::nullopt;
  // Event functions of the scene's planes, whose parameters are additional unknowns; not together with a law.
  std::optional<EventFunctions> events = std::nullopt;
  int threads = 1;  // simulate segments at the same time; 0: one per core; results do not depend on it
  StopRequest stop = nullptr;
  std::function<void(const std::string&)> status = nullptr;  // receives lines about what is being computed
};

enum class Determination {
  kDetermined,
  kCombined,      // the data determine only a combination of this parameter with others
  kUndetermined,  // the data do not determine it
  kAtBound,       // the fit has it at its bound, where there is no standard error
};
const char* DeterminationToString(Determination determination);

struct Estimate {
  Unknown unknown;  // of a scene
  std::string name;
  double start = 0;  // value in the scene, in the scene's units
  // The estimate, its error and its interval have no meaning if the parameter is not determined.
  double value = 0;
  double standard_error = 0;
  double low = 0, high = 0;  // 95 % confidence, within the bounds
  Determination determination = Determination::kDetermined;
  std::vector<std::string> with;  // kCombined: names of the other parameters
};

struct SampleResidual {
  int recording = 0, sample = 0;          // indices
  int quantity = 0;                       // into IdentifyReport::quantities
  int line = 0;                           // of the recording's file, from 1; 0: of none
  double time = 0;                        // s
  std::vector<double> measured = {};      // of a scene the position, m
  std::vector<double> predicted = {};     // by the motion
  std::vector<double> standardised = {};  // (predicted - measured) / sigma
  bool outlier = false;
};

enum class FitVerdict {
  kFits,
  kNotDetermined,  // the data determine no unknown, although a motion may fit them
  kContradicted,   // residuals are far larger than sigma, or than the extent of the motion allows
  kNotJudged,      // it is open whether the model is right: too few samples, too many outliers, or a bound reached
  kFailed,         // no start has a motion to compare with; see `reason`
  kNotConverged,
  kInterrupted,
  kNotApplicable,  // the contact model does not support the scene, or the request is wrong; see `reason`
};
const char* FitVerdictToString(FitVerdict verdict);

// The values of a law at the speeds of an impact.
struct LawPoint {
  double speed = 0, sliding = 0;  // of approach, of sliding, m/s
  double restitution = 0, restitution_error = 0;
  double friction = 0, friction_error = 0;  // of laws of friction
};

// A fitted law of impact.
struct LearnedLaw {
  ImpactLaw law;
  int impacts = 0;
  // The law from the slowest to the fastest impact of the motion, at the median of their sliding speeds. The errors are
  // standard errors by the recordings and the prior.
  std::vector<LawPoint> curve;
};

// An impact with a plane by fitted event functions.
struct LearnedImpact {
  int segment = 0, body = 0, plane = 0;  // indices: of IdentifyReport::initial, of Scene::bodies and planes
  Vec2d position = Vec2d::Zero();        // m, of the disc
  Vec2d before = Vec2d::Zero();          // m/s, its velocity
  Vec2d after = Vec2d::Zero();           // m/s
  Vec2d normal = Vec2d::Zero();          // of the event function there
  double scene_gap = 0;                  // m, gap to the scene's plane; 0 if both surfaces agree
};

// Fitted event functions.
struct LearnedEventFunctions {
  EventFunctions functions;
  std::vector<LearnedImpact> impacts;  // of the motion; the first of each step
};

// The result of a fit. Estimates have no meaning if the verdict is kFailed or kNotApplicable.
struct IdentifyReport {
  FitVerdict verdict = FitVerdict::kFailed;
  std::string reason;
  std::vector<std::string> remarks;  // that sigma was estimated, that residuals are systematic, and similar
  std::vector<Estimate> estimates;
  std::vector<std::vector<double>> correlation;  // D x D, of the D determined parameters, in their order
  std::vector<std::vector<double>> initial;      // of each segment, in the layout of simulator.h (B x 4 or B x 6)
  std::vector<double> segment_begin;             // s, of each segment
  std::vector<int> segment_recording;            // of each segment
  std::vector<SampleResidual> residuals;         // of all samples, in order
  std::vector<std::string> recordings;           // their names
  std::vector<std::string> quantities;           // names of what was measured; in a scene of its bodies
  std::optional<LearnedLaw> law;                 // the fitted law, if IdentifyOptions::law is set
  std::optional<LearnedEventFunctions> events;   // the fitted event functions, if IdentifyOptions::events is set
  double cost = 0;                               // the minimum, with rho and the prior of a law
  double sigma = 0;            // m, estimated from the residuals if the samples have none; otherwise 0
  std::vector<double> sigmas;  // of a hybrid system: that of each quantity, in its unit; none if they are stated
  // Typical |r| relative to its value for noise of the stated sigma; about 1 if the model is right. 0 without sigma.
  double misfit = 0;
  int impacts = 0;                      // number of contacts in the motion at the minimum, of all segments
  int iterations = 0, evaluations = 0;  // of all fits; evaluations are of all segments
  int starts = 0, sequences = 0;        // number of fits, and of different sequences of impacts in which they ended
  double seconds = 0;
};

// Fits the unknowns, and the initial states of measured discs, to recordings of a scene under a contact model. Errors
// in the arguments, and a model that does not support the scene, are reported as kNotApplicable with the reason.
IdentifyReport Identify(const Contact& contact, const Scene& scene, const std::vector<Recording>& recordings,
                        const std::vector<Unknown>& unknowns, const IdentifyOptions& options = {});

// Returns the scene with the values of a fit, its walls where the fit puts them.
Scene FittedScene(const Scene& scene, const std::vector<Estimate>& estimates);

}  // namespace saltus
