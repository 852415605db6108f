// All numeric thresholds of the event-driven model (event/event.h) and of the solvers of its contact forces.
//
// Lengths, speeds and accelerations are multiples of the natural ones of the scene (scene/units.h); "of x" is relative
// to x. In brackets: the test whose scenes fail if the threshold is wrong by orders of magnitude, event_<name>_test or,
// of the solvers, <name>_test. Without brackets it limits work only.
#pragma once

#include <cstddef>

#include "base/time_grid.h"  // kNodeMargin: events this close to the end of a step belong to the next one

namespace saltus::internal {

// Gaps, lengths.
inline constexpr double kRoundingGap = 1e-14;      // a gap that is zero up to rounding [roots, at_once]
inline constexpr double kRoundingOfSteps = 1e-12;  // of positions: rounding over many steps [at_once]
inline constexpr double kContactGap = 1e-10;       // up to which a pair touches [rest]
inline constexpr double kLargestDrift = 3e-11;     // error of a gap that a sub-step may reach [rolling, rest]
inline constexpr double kSeam = 1e-12;             // by which an edge counts beyond its end (walls.h) [edges]
inline constexpr double kLargestOverlap = 1e-9;    // growth of an overlap, beyond which a step fails [piles, stress]

// Speeds and accelerations.
inline constexpr double kSlowSpeed = 1e-6;         // up to which a pair that touches does not bounce [rest]
inline constexpr double kLargestSlowSpeed = 1e-2;  // the same after many impacts within a pile [piles]
inline constexpr double kSharpSpeed = 1e-9;        // slower impacts have a time without derivative [rest]
inline constexpr double kStickSpeed = 1e-9;        // up to which a contact does not slide [rest, sides]
inline constexpr double kStillSpeed = 1e-14;       // up to which a gap does not close up to rounding [rest]
inline constexpr double kPushing = 1e-11;          // acceleration that closes a gap [rest]
inline constexpr double kHeadOn = 1e-9;            // of the closing speed: an impact that does not slide [gradient]

// Angles, rad.
inline constexpr double kLongestTurn = 0.05;  // of a normal within a sub-step with friction [rolling]

// Shares.
inline constexpr double kSubStepEnd = 1e-6;   // of a sub-step: an event this close to its end is at its end [rolling]
inline constexpr double kLargestGain = 1e-9;  // of the energy: its growth, beyond which a step fails [piles, stress]
inline constexpr double kBeyondModeEnd = 1e-11;  // of a normal force: by which it is past the end of a mode [rolling]
inline constexpr double kOpenForce = 1e-12;      // of the largest force of a group: a contact is open [rest, piles]
inline constexpr double kAtBound = 1e-12;        // of the bound of friction: a contact slides [rest]
inline constexpr double kOverlapOfOpen = 0.1;    // of kContactGap: the overlap from which open contacts are closed

// Numbers of events in a step.
inline constexpr int kMaxEvents = 200000;    // after which a step fails [counting]
inline constexpr int kManyImpacts = 2000;    // after which slow speeds grow within piles without friction [piles]
inline constexpr int kRepeatedImpacts = 32;  // of a pair and of its discs with others, likewise [piles]
inline constexpr int kMostSubStepCuts = 8;   // in succession, at the ends of contact modes [rolling]
inline constexpr int kMostClosings = 4;      // of a quartic, with a maximum below zero [edges]

// Time-stepping fallback (event_fallback.h): numbers that are no larger if pairs that do not touch are left out, as
// they are where derivatives are taken.
inline constexpr int kFewestFallbackDiscs = 5;   // of a step that would fail [piles]
inline constexpr int kManyDiscs = 32;            // with repeated impacts, or in one contact group [piles]
inline constexpr int kMostLargeGroups = 2;       // contact groups of kManyDiscs contacts or more [piles]
inline constexpr int kMostFallbackRounds = 100;  // in which discs join
inline constexpr double kActiveImpulse = 1e-12;  // of the largest impulse: a contact is active [piles]

// Ties (event_ties.h): impacts at the same time. The gap counts with kTieTime, and where rounding decides.
inline constexpr double kTieGap = 1e-9;                   // of the contact distance [ties]
inline constexpr double kTieTime = 1e-6;                  // of the step [ties]
inline constexpr double kTieRounding = 1e-13;             // of the coordinates of the discs [ties]
inline constexpr double kTieSpeed = 1e-6;                 // of the fastest impact: outcomes are the same [ties]
inline constexpr double kTieSlowSpeed = 10 * kSlowSpeed;  // the same, absolute [ties]
inline constexpr int kMostTiedImpacts = 10000;            // of one tie, that are taken in one order
inline constexpr int kAllTieOrders = 4;                   // contacts of which all orders are tried [ties]

// Forces of resting contacts (solvers/resting_forces.h); accelerations are of the largest that is given.
inline constexpr double kForcesConverged = 1e-14;  // change of a sweep [resting_forces]
inline constexpr double kForcesDirect = 1e-12;     // residual of a linear system of contact modes [resting_forces]
inline constexpr double kForcesNearly =
    1e-9;                                     // the same of redundant contacts that do not quite agree [resting_forces]
inline constexpr double kForcesJammed = 1e9;  // change of a sweep that diverges [resting_forces]
inline constexpr int kForcesMostSweeps = 20000;
inline constexpr int kForcesFirstSweeps = 32;       // before the first linear system
inline constexpr int kForcesLongSweeps = 1024;      // before hypotheses are tried one after the other
inline constexpr int kForcesMostHypotheses = 4096;  // combinations of contact modes
inline constexpr int kForcesMostPivots = 1000;
inline constexpr int kForcesFirstPivots = 12;   // of many contacts, before the first sweep
inline constexpr int kForcesLimitedPivots = 4;  // of many contacts, where time-stepping may replace them

// Complementarity problems (solvers/complementarity.h).
inline constexpr int kBlockPatience = 3;      // block steps without progress before single ones [lcp_solver]
inline constexpr double kLemkePivot = 1e-11;  // of the largest entry of M: smaller ones are rounding [complementarity]
inline constexpr double kLemkeTie = 1e-15;    // of the largest entry of q: rows that leave together [complementarity]
inline constexpr int kLemkePivotsPerRow = 10;
inline constexpr int kMostComplementaryRows = 800;

// Linear systems of contacts (solvers/contact_system.h).
inline constexpr int kMostDenseRows = 16;        // beyond which they are sparse
inline constexpr double kDependentRows = 1e-10;  // of the largest pivot of a dense one: redundant rows [contact_system]
inline constexpr double kSystemShift = 1e-9;  // of the largest diagonal entry, added to the diagonal [contact_system]
inline constexpr double kSystemAlike = 1e-6;  // difference of directions that share a factorization [contact_system]
inline constexpr double kSystemRemainder = 1e-15;  // of the right side: the iteration ends [contact_system]
inline constexpr double kSystemConverged = 1e-10;  // of the right side: the residual is rounding [contact_system]
inline constexpr int kSystemMostCorrections = 30;
inline constexpr std::size_t kSystemKeptFactors = 4;  // factorizations that are kept for the next step

// Impulses of the fallback (solvers/impulse_qp.h); speeds are of the largest that is given.
inline constexpr double kQpConverged = 1e-13;   // change of a sweep, or violation [impulse_qp]
inline constexpr double kQpCentralEnd = 1e-12;  // residual on the central path [impulse_qp]
inline constexpr double kQpNearly = 1e-6;       // the same, accepted if the refinement does not improve it [impulse_qp]
inline constexpr double kQpLeastPart = 1e-2;    // of a step that is taken on the central path
inline constexpr double kQpToBoundary = 0.995;  // of the way to where a push or a gap is zero
inline constexpr double kQpCompliance = 2e-6;   // of a row, of its own inverse mass [impulse_qp]
inline constexpr int kQpSweeps = 50;
inline constexpr int kQpMostCentral = 100;
inline constexpr int kQpMostMultipliers = 20;  // updates of the augmented Lagrangian
inline constexpr int kQpMostNewton = 15;       // steps in all of these
inline constexpr int kQpMostHalvings = 50;

}  // namespace saltus::internal
