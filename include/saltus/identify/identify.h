// Parameters of a scene from recordings of its motion: nonlinear least squares through impacts.
//
//   min over parameters, and the initial state of each segment, of   sum over samples of 1/2 rho(|r|^2)
//   r = (x(time) - position) / sigma                                  and of velocities, where they were measured
//
// x(time) is the motion under a contact model; derivatives are forward sensitivities of its own steps, which with
// `event` are exact through every impact. Parameters that have bounds are transformed, so that no iterate leaves them.
// The cost jumps where the collision sequence changes: fits begin with the part before most of the impacts, and from
// several starts, of which the best is kept.
//
// The law of impact itself may be unknown: a function with parameters, such as a network (impact_law.h). So may where
// and how discs bounce off planes (event_functions.h).
//
// A recording may be cut into segments with an initial state each: long ones must be, as after many impacts the motion
// depends on its start beyond what can be measured.
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

// One number to identify: of a contact parameter, mass, gravity, a force or a law.
using Unknown = SceneParameter;
// Names separated by commas; "gravity" and "force.ball" are both components. Else what was found and expected.
std::variant<std::vector<Unknown>, std::string> ParseUnknowns(std::string_view names, const Scene& scene);

enum class RobustLoss { kNone, kHuber, kCauchy };

struct IdentifyOptions {
  RobustLoss loss = RobustLoss::kHuber;
  double loss_scale = 2;       // of |r|, in sigmas, beyond which a sample counts less
  double segment = 0;          // s, > 0: recordings are cut into segments of this length; 0: they are not
  bool initial_states = true;  // are unknown, of the discs that were measured; else they are those of the scene
  int starts = 12;             // at most
  double outlier = 4;          // |r| in sigmas from which on a sample is named an outlier
  int max_iterations = 100;    // of each fit
  // A law of the impacts, with its parameters as unknowns beside the others; only `event` takes it, in its motion too.
  std::optional<ImpactLaw> law = std::nullopt;
  // Functions for the scene's planes, whose parameters are unknowns too; not together with a law.
  std::optional<EventFunctions> events = std::nullopt;
  int threads = 1;
  StopRequest stop = nullptr;
  std::function<void(const std::string&)> status = nullptr;  // told what is at work
};

enum class Determination {
  kDetermined,
  kCombined,      // the data determine only a combination of this parameter with others
  kUndetermined,  // the data say nothing of it, or next to nothing
  kAtBound,       // the samples push it to its bound or beyond, where there is no standard error
};
const char* DeterminationToString(Determination determination);

struct Estimate {
  Unknown unknown;
  std::string name;
  double start = 0;  // in the scene
  // The numbers of an estimate, which have no meaning if it is not determined.
  double value = 0;
  double standard_error = 0;
  double low = 0, high = 0;  // 95 % confidence, within the bounds
  Determination determination = Determination::kDetermined;
  std::vector<std::string> with;  // kCombined: the others
};

struct SampleResidual {
  int recording = 0, sample = 0;
  Vec2d predicted = Vec2d::Zero();     // m
  Vec2d standardised = Vec2d::Zero();  // (predicted - measured) / sigma
  bool outlier = false;
};

enum class FitVerdict {
  kFits,
  kNotDetermined,  // the data say nothing of anything that is unknown, though a motion may pass through them
  kContradicted,   // samples miss the motion by far more than their sigma, or the extent of the motion allows
  kNotJudged,      // the samples are too few to say, or without a sigma do not tell, whether the model is right
  kFailed,         // no start has a motion that can be simulated and compared, see `reason`
  kNotConverged,
  kInterrupted,
  kNotApplicable,  // the contact model cannot take the scene, or the request makes no sense: see `reason`
};
const char* FitVerdictToString(FitVerdict verdict);

// The values of a law for impacts at these speeds, m/s.
struct LawPoint {
  double speed = 0, sliding = 0;  // of approach, of sliding
  double restitution = 0, restitution_error = 0;
  double friction = 0, friction_error = 0;  // of laws of friction
};

// A law of impact as it was learned.
struct LearnedLaw {
  ImpactLaw law;
  int impacts = 0;
  // The law from the slowest to the fastest impact of the motion, at the sliding speed that is the median of theirs.
  // The errors are standard errors, of what recordings and prior leave open.
  std::vector<LawPoint> curve;
};

// One impact with a plane, as event functions that were learned have it.
struct LearnedImpact {
  int segment = 0, body = 0, plane = 0;
  Vec2d position = Vec2d::Zero();  // m, of the disc
  Vec2d before = Vec2d::Zero();    // m/s, its velocity
  Vec2d after = Vec2d::Zero();
  Vec2d normal = Vec2d::Zero();  // of the event function there
  double scene_gap = 0;          // m, of the scene's plane: 0 if that is where it says
};

// Event functions as they were learned.
struct LearnedEventFunctions {
  EventFunctions functions;
  std::vector<LearnedImpact> impacts;  // of the motion, of each step the first
};

struct IdentifyReport {
  FitVerdict verdict = FitVerdict::kFailed;
  std::string reason;
  std::vector<std::string> remarks;  // what else is to be known: that sigma was estimated, or residuals are systematic
  std::vector<Estimate> estimates;
  std::vector<std::vector<double>> correlation;  // of the determined ones, in their order
  std::vector<std::vector<double>> initial;      // of each segment, B x 4
  std::vector<double> segment_begin;             // s, of each segment
  std::vector<int> segment_recording;            // of each segment
  std::vector<SampleResidual> residuals;         // of all samples, in order
  std::optional<LearnedLaw> law;                 // if one was to be learned
  std::optional<LearnedEventFunctions> events;   // likewise
  double cost = 0;                               // the minimum, with rho and the prior of a law
  double sigma = 0;                              // m, estimated from the residuals if samples state none; else 0
  // Typical |r| over what noise of the stated sigma makes of it; 1 if the model is right. 0 if none is stated.
  double misfit = 0;
  int impacts = 0;                      // contacts in the motion at the minimum, of all segments
  int iterations = 0, evaluations = 0;  // of all fits; evaluations are of all segments
  int starts = 0, sequences = 0;        // fits, and different contact sequences in which they ended
  double seconds = 0;
};

IdentifyReport Identify(const Contact& contact, const Scene& scene, const std::vector<Recording>& recordings,
                        const std::vector<Unknown>& unknowns, const IdentifyOptions& options = {});

}  // namespace saltus
