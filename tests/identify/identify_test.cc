// Parameters from recordings: derivatives through impacts, fits of problems whose parameters are known, what is not
// determined or contradicted, and recordings that are wrong.
#include "saltus/identify/identify.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <memory>

#include "identify/generated_problem.h"
#include "identify/segment_motion.h"
#include "identify/statistics.h"
#include "identify/unknowns.h"
#include "parameter_name.h"

namespace saltus {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using Kind = Unknown::Kind;

// Two discs and a floor: one falls and slides, the other is hit.
Scene DropAndHit() {
  Scene scene;
  scene.name = "drop_and_hit";
  scene.duration = 1;
  scene.steps = 50;
  scene.gravity = {0.2, -5};
  scene.bodies = {{.name = "a", .radius = 0.1, .mass = 1.2, .position = {-0.6, 0.4}, .velocity = {1.5, 0}},
                  {.name = "b", .radius = 0.15, .mass = 0.7, .position = {0.05, 0.6}, .velocity = {0, 0.3}}};
  scene.planes = {{"floor", {0, 0}, {0, 1}}};
  scene.contact = {.restitution = 0.7, .friction = 0.1};
  scene.control = {{0}, {{0.3, 0.1}}};
  return scene;
}

std::vector<Unknown> AllOf(const Scene& scene) {
  return std::get<std::vector<Unknown>>(
      ParseUnknowns("restitution,friction,gravity,mass.a,mass.b,force.a,force.b.y", scene));
}

// Where a and b are at times on and between nodes, and in steps with impacts before and after these.
Recording Times(const Scene& scene) {
  Recording recording{"times", {}};
  for (double time = 0.013; time < scene.duration; time += 0.0171) {
    for (int body = 0; body < 2; ++body) recording.samples.push_back({.time = time, .body = body, .sigma = 1});
  }
  recording.samples.push_back({.time = 1, .body = 0, .sigma = 1});
  return recording;
}

MotionAtSamples Move(const std::string& contact, const Scene& scene, const Recording& recording,
                     const std::vector<Unknown>& unknowns, const std::vector<double>& initial) {
  const Segment segment{0, 0, 0, static_cast<int>(recording.samples.size()), initial};
  return MoveThrough(contact, scene, segment, {&recording.samples, unknowns, {0, 1}}, true);
}

void ExpectDerivativesOfDifferences(const char* contact, Scene scene, const std::vector<Unknown>& unknowns) {
  for (const Unknown& unknown : unknowns) SetValue(unknown, ValueOf(unknown, scene), &scene);
  const Recording recording = Times(scene);
  const std::vector<double> initial = InitialState(scene);
  const MotionAtSamples motion = Move(contact, scene, recording, unknowns, initial);
  ASSERT_TRUE(motion.ok) << motion.reason;
  ASSERT_GE(motion.touches.size(), 3u);
  const double width = 1e-7;
  for (std::size_t column = 0; column < unknowns.size() + 8; ++column) {
    const auto shifted = [&](double by) {
      Scene other = scene;
      std::vector<double> start = initial;
      if (column < unknowns.size()) {
        SetValue(unknowns[column], ValueOf(unknowns[column], scene) + by, &other);
        start = InitialState(other);  // fixed discs are part of it
      } else {
        start[column - unknowns.size()] += by;
      }
      return Move(contact, other, recording, unknowns, start);
    };
    const MotionAtSamples up = shifted(width), down = shifted(-width);
    ASSERT_EQ(up.touches.size(), down.touches.size());
    for (std::size_t i = 0; i < recording.samples.size(); ++i) {
      const Eigen::Vector4d difference = (up.state[i] - down.state[i]) / (2 * width);
      const double scale = 1 + difference.cwiseAbs().maxCoeff();
      ASSERT_LT((motion.derivative[i].col(static_cast<Eigen::Index>(column)) - difference).cwiseAbs().maxCoeff(),
                2e-5 * scale)
          << "column " << column << " at " << recording.samples[i].time;
    }
  }
}

class DerivativeUnder : public testing::TestWithParam<const char*> {};

TEST_P(DerivativeUnder, IsThatOfDifferences) {
  ExpectDerivativesOfDifferences(GetParam(), DropAndHit(), AllOf(DropAndHit()));
}

// A disc falls on a floor and then strikes a post, another one falls on a ramp.
Scene DropAtPostAndRamp() {
  Scene scene = DropAndHit();
  scene.bodies[1].position = {-1.5, 0.5};
  scene.bodies.push_back({.name = "post", .radius = 0.1, .fixed = true, .position = {0.42, 0.25}});
  scene.segments = {{.name = "ramp", .from = {-1, 0.1}, .to = {-2, 0.3}}};
  return scene;
}

TEST_P(DerivativeUnder, GeometryIsThatOfDifferences) {
  const Scene scene = DropAtPostAndRamp();
  const auto unknowns = std::get<std::vector<Unknown>>(ParseUnknowns(
      "restitution,offset.floor,angle.floor,offset.ramp,angle.ramp,position.post,radius.a,radius.b,radius.post",
      scene));
  ExpectDerivativesOfDifferences(GetParam(), scene, unknowns);
  const MotionAtSamples motion = Move(GetParam(), scene, Times(scene), {}, InitialState(scene));
  const auto touches = [&](const Candidate& candidate) {
    return std::ranges::any_of(motion.touches,
                               [&](const StepTouch& touch) { return touch.touch.candidate == candidate; });
  };
  EXPECT_TRUE(touches({0, 0, true}) && touches({0, 2, false}));  // the floor and the post
  EXPECT_TRUE(std::ranges::any_of(motion.touches, [](const StepTouch& touch) {
    return touch.touch.candidate.plane && touch.touch.candidate.a == 1;
  })) << "the ramp";
}
INSTANTIATE_TEST_SUITE_P(Models, DerivativeUnder, testing::Values("event", "qcqp", "smooth_compliant"),
                         ParameterName());

// The disc that is hit falls into a pocket where it would be late in the motion.
TEST(SegmentMotion, HasDerivativesThroughAPocket) {
  Scene scene = DropAndHit();
  Recording late{"late", {{.time = 0.85, .body = 1, .sigma = 1}}};
  const MotionAtSamples motion = Move("event", scene, late, {}, InitialState(scene));
  scene.pockets = {{.name = "hole", .position = motion.state[0].head<2>(), .radius = 0.05}};
  ExpectDerivativesOfDifferences("event", scene, AllOf(scene));
  late.samples[0].time = 1;
  const MotionAtSamples potted = Move("event", scene, late, {}, InitialState(scene));
  EXPECT_NEAR((potted.state[0].head<2>() - scene.pockets[0].position).norm(), 0.05, 1e-12);
  EXPECT_EQ(potted.state[0].tail<2>().norm(), 0);
}

// Between two nodes the motion is that of a grid which has the time for a node.
TEST(SegmentMotion, IsThatOfAFinerGrid) {
  Scene scene = DropAndHit(), fine = scene;
  fine.steps = 1000;
  Recording recording{"nodes", {}};
  for (int k = 1; k <= 1000; k += 3) recording.samples.push_back({.time = k * 1e-3, .body = k % 2, .sigma = 1});
  const std::vector<double> initial = InitialState(scene);
  const MotionAtSamples coarse = Move("event", scene, recording, {}, initial);
  const MotionAtSamples exact = Move("event", fine, recording, {}, initial);
  for (std::size_t i = 0; i < recording.samples.size(); ++i) {
    EXPECT_LT((coarse.state[i] - exact.state[i]).norm(), 1e-10) << recording.samples[i].time;
  }
}

// A few of tests/campaign/identify_problems.
TEST(Identify, FindsTheParametersOfGeneratedProblems) {
  int found = 0, intervals = 0, covered = 0;
  const int count = 30;
  for (int seed = 1; seed <= count; ++seed) {
    const GeneratedProblem problem = GenerateProblem(seed);
    const IdentifyReport report = Identify("event", problem.guess, {problem.recording}, problem.unknowns);
    bool ok = report.verdict == FitVerdict::kFits;
    for (const Estimate& estimate : report.estimates) {
      if (estimate.determination != Determination::kDetermined) continue;
      const double truth = TrueValue(problem, estimate.unknown);
      ++intervals;
      covered += truth >= estimate.low && truth <= estimate.high;
      ok = ok && std::abs(estimate.value - truth) < 6 * estimate.standard_error;
    }
    found += ok;
  }
  EXPECT_GE(found, 28);
  EXPECT_GE(covered, 0.85 * intervals);
}

// A ball that falls on the floor, measured 60 times a second.
GeneratedProblem Bounce(double noise = 1e-3) {
  GeneratedProblem problem;
  problem.truth.name = "bounce";
  problem.truth.duration = 1.5;
  problem.truth.steps = 90;
  problem.truth.gravity = {0, -9.81};
  problem.truth.bodies = {{.name = "ball", .radius = 0.05, .mass = 0.3, .position = {0, 1}, .velocity = {0.4, 0}}};
  problem.truth.planes = {{"floor", {0, 0}, {0, 1}}};
  problem.truth.contact.restitution = 0.75;
  GeneratedRandom random(4);
  problem.recording.name = "bounce";
  Measure(noise, 0, &random, &problem);
  problem.guess = problem.truth;
  problem.guess.contact.restitution = 0.5;
  return problem;
}

// Without noise the parameters come out to what the solver resolves.
TEST(Identify, IsExactWithoutNoise) {
  GeneratedProblem problem = Bounce(1e-9);
  for (Sample& sample : problem.recording.samples) sample.sigma = 1e-3;
  const IdentifyReport report = Identify("event", problem.guess, {problem.recording}, {{Kind::kRestitution}});
  EXPECT_EQ(report.verdict, FitVerdict::kFits) << report.reason;
  EXPECT_NEAR(report.estimates[0].value, 0.75, 1e-6);
}

// A table that is not where its drawing has it: a floor too low and not level, and a post to the side.
TEST(Identify, FindsThePlacesOfWallsAndPosts) {
  GeneratedProblem problem = Bounce(1e-3);
  problem.truth.bodies[0].velocity = {1.2, 0};
  problem.truth.bodies.push_back({.name = "post", .radius = 0.1, .fixed = true, .position = {1.1, 0.3}});
  problem.guess = problem.truth;
  SetValue({Kind::kPlaneAngle, 0}, 0.05, &problem.truth);
  SetValue({Kind::kPlaneOffset, 0}, -0.08, &problem.truth);
  problem.truth.bodies[1].position += Vec2d(0.03, -0.04);
  problem.recording.samples.clear();
  GeneratedRandom random(5);
  Measure(1e-3, 0, &random, &problem);
  std::erase_if(problem.recording.samples, [](const Sample& sample) { return sample.body != 0; });
  const auto unknowns = std::get<std::vector<Unknown>>(
      ParseUnknowns("restitution,offset.floor,angle.floor,position.post", problem.guess));
  const IdentifyReport report = Identify("event", problem.guess, {problem.recording}, unknowns);
  EXPECT_EQ(report.verdict, FitVerdict::kFits) << report.reason;
  const std::vector<double> truth = {0.75, -0.08, 0.05, 1.13, 0.26};
  ASSERT_EQ(report.estimates.size(), truth.size());
  for (std::size_t u = 0; u < truth.size(); ++u) {
    const Estimate& estimate = report.estimates[u];
    EXPECT_EQ(estimate.determination, Determination::kDetermined) << estimate.name;
    EXPECT_LT(std::abs(estimate.value - truth[u]), 4 * estimate.standard_error) << estimate.name;
    EXPECT_LT(estimate.standard_error, 5e-3) << estimate.name;
  }
}

// Two restitutions from one recording: those of a ball with its floor and with walls of another material.
// A floor is turned to the left by a right angle about its point, and then moved along its new normal.
TEST(Identify, AFittedSceneHasWallsThatAreTurnedBeforeTheyAreMoved) {
  Scene scene;
  scene.planes = {{"floor", {2, 1}, {0, 1}}};
  Estimate offset, angle;
  offset.unknown = {Kind::kPlaneOffset, 0};
  offset.value = 0.5;
  angle.unknown = {Kind::kPlaneAngle, 0};
  angle.value = std::acos(0.0);
  for (const std::vector<Estimate>& estimates : {std::vector{offset, angle}, std::vector{angle, offset}}) {
    const Plane floor = FittedScene(scene, estimates).planes[0];
    EXPECT_NEAR((floor.normal - Vec2d(-1, 0)).norm(), 0, 1e-15);
    EXPECT_NEAR((floor.point - Vec2d(1.5, 1)).norm(), 0, 1e-15);
  }
}

TEST(Identify, FindsTheRestitutionOfEachPairOfMaterials) {
  GeneratedProblem problem;
  Scene& scene = problem.truth;
  scene.name = "walls";
  scene.duration = 3;
  scene.steps = 180;
  scene.gravity = {0, -9.81};
  scene.bodies = {
      {.name = "ball", .radius = 0.05, .mass = 0.3, .position = {0, 1}, .velocity = {1.5, 0}, .material = 0}};
  scene.planes = {{"floor", {0, 0}, {0, 1}, 1}, {"left", {-0.5, 0}, {1, 0}, 2}, {"right", {0.5, 0}, {-1, 0}, 2}};
  scene.materials = {{"rubber", {0.9, 0}}, {"steel", {0.7, 0}}, {"wood", {0.5, 0}}};
  scene.pairs = {{0, 2, 0.62, std::nullopt}};
  GeneratedRandom random(4);
  problem.recording.name = "walls";
  Measure(1e-3, 0, &random, &problem);
  problem.guess = problem.truth;
  problem.guess.materials = {{"rubber", {0.5, 0}}, {"steel", {0.9, 0}}, {"wood", {0.5, 0}}};
  problem.guess.pairs.clear();
  const auto unknowns =
      std::get<std::vector<Unknown>>(ParseUnknowns("restitution.rubber-steel,restitution.wood-rubber", scene));
  const IdentifyReport report = Identify("event", problem.guess, {problem.recording}, unknowns);
  ASSERT_EQ(report.verdict, FitVerdict::kFits) << report.reason;
  ASSERT_EQ(report.estimates.size(), 2u);
  EXPECT_EQ(report.estimates[1].name, "restitution.rubber-wood");
  for (int i = 0; i < 2; ++i) {
    const Estimate& estimate = report.estimates[i];
    EXPECT_EQ(estimate.determination, Determination::kDetermined);
    EXPECT_NEAR(estimate.value, i == 0 ? 0.8 : 0.62, 5 * estimate.standard_error);
    EXPECT_LT(estimate.standard_error, 2e-3);
  }
  EXPECT_THAT(std::get<std::string>(ParseUnknowns("restitution", scene)),
              HasSubstr("expected some of restitution.rubber-steel, restitution.rubber-wood, friction.rubber-steel"));
  const IdentifyReport law =
      Identify("event", problem.guess, {problem.recording}, {}, {.law = RestitutionNetwork(2, 3, 0.5)});
  EXPECT_THAT(law.reason, HasSubstr("found a law of impact in a scene with materials"));
}

TEST(Identify, SaysWhatNoImpactReveals) {
  const GeneratedProblem problem = Bounce();
  const std::vector<Unknown> unknowns = {{Kind::kRestitution}, {Kind::kMass, 0}, {Kind::kGravity, -1, 1}};
  const IdentifyReport report = Identify("event", problem.guess, {problem.recording}, unknowns);
  ASSERT_EQ(report.verdict, FitVerdict::kFits) << report.reason;
  EXPECT_NEAR(report.estimates[0].value, 0.75, 5 * report.estimates[0].standard_error);
  EXPECT_LT(report.estimates[0].standard_error, 0.01);
  EXPECT_EQ(report.estimates[1].determination, Determination::kUndetermined);
  EXPECT_NEAR(report.estimates[2].value, -9.81, 5 * report.estimates[2].standard_error);
  EXPECT_EQ(report.correlation.size(), 2u);
}

// Neither noise nor one sample a segment says anything of the restitution, though some motion passes near by.
TEST(Identify, WhatDeterminesNothingIsNoFit) {
  GeneratedProblem noise = Bounce();
  GeneratedRandom random(8);
  for (Sample& sample : noise.recording.samples) {
    sample.sigma = 0;
    sample.position = {random.Uniform(-1, 1), random.Uniform(-1, 1)};
  }
  const IdentifyReport of_noise = Identify("event", noise.guess, {noise.recording}, {{Kind::kRestitution}});
  EXPECT_NE(of_noise.verdict, FitVerdict::kFits);
  EXPECT_FALSE(of_noise.reason.empty());

  for (const double sigma : {0.0, 1e-3}) {
    GeneratedProblem cut = Bounce();
    for (Sample& sample : cut.recording.samples) sample.sigma = sigma;
    const IdentifyReport report =
        Identify("event", cut.guess, {cut.recording}, {{Kind::kRestitution}}, {.segment = 1e-9});
    EXPECT_EQ(report.verdict, FitVerdict::kNotDetermined) << report.reason;
    EXPECT_EQ(report.reason, "the samples have no more numbers than there are unknowns");
    EXPECT_EQ(report.estimates[0].determination, Determination::kUndetermined);
    EXPECT_TRUE(std::isfinite(report.cost) && std::isfinite(report.sigma));
  }
}

// Measurements without any error leave nothing to estimate an error from, and are a fit all the same.
TEST(Identify, SamplesWithoutErrorFit) {
  GeneratedProblem problem = Bounce(0);
  for (Sample& sample : problem.recording.samples) sample.sigma = 0;
  const IdentifyReport report = Identify("event", problem.guess, {problem.recording}, {{Kind::kRestitution}});
  ASSERT_EQ(report.verdict, FitVerdict::kFits) << report.reason;
  EXPECT_NEAR(report.estimates[0].value, 0.75, 1e-9);
  EXPECT_TRUE(std::isfinite(report.estimates[0].standard_error));
}

// Gravity and a force are one acceleration.
TEST(Identify, SaysWhatIsDeterminedOnlyTogether) {
  const GeneratedProblem problem = Bounce();
  const std::vector<Unknown> unknowns = {{Kind::kRestitution}, {Kind::kGravity, -1, 0}, {Kind::kForce, 0, 0}};
  const IdentifyReport report = Identify("event", problem.guess, {problem.recording}, unknowns);
  EXPECT_EQ(report.estimates[0].determination, Determination::kDetermined);
  EXPECT_EQ(report.estimates[1].determination, Determination::kCombined);
  EXPECT_THAT(report.estimates[1].with, ElementsAre("force.ball.x"));
  EXPECT_THAT(report.estimates[2].with, ElementsAre("gravity.x"));
}

// Recordings of two balls said to be of one restitution: no value fits both.
TEST(Identify, SaysThatDataAreContradictory) {
  const GeneratedProblem one = Bounce();
  GeneratedProblem other = Bounce();
  other.truth.contact.restitution = 0.4;
  other.recording.samples.clear();
  GeneratedRandom random(5);
  Measure(1e-3, 0, &random, &other);
  const IdentifyReport report = Identify("event", one.guess, {one.recording, other.recording}, {{Kind::kRestitution}});
  EXPECT_EQ(report.verdict, FitVerdict::kContradicted);
  EXPECT_THAT(report.reason, HasSubstr("outliers"));
}

TEST(Identify, SharesParametersAndNamesOutliers) {
  GeneratedProblem one = Bounce(), two = Bounce();
  two.truth.bodies[0].velocity = {-0.8, 1};
  two.recording.samples.clear();
  GeneratedRandom random(6);
  Measure(1e-3, 0, &random, &two);
  one.recording.samples[20].position += Vec2d(0.05, 0);
  const IdentifyReport alone = Identify("event", one.guess, {one.recording}, {{Kind::kRestitution}});
  const IdentifyReport both = Identify("event", one.guess, {one.recording, two.recording}, {{Kind::kRestitution}});
  ASSERT_EQ(both.verdict, FitVerdict::kFits) << both.reason;
  EXPECT_LT(both.estimates[0].standard_error, alone.estimates[0].standard_error);
  EXPECT_NEAR(both.initial[1][2], -0.8, 0.02);
  std::vector<int> outliers;
  for (const SampleResidual& at : both.residuals) {
    if (at.outlier) outliers.push_back(at.recording * 1000 + at.sample);
  }
  EXPECT_THAT(outliers, testing::Contains(20));
  EXPECT_LT(outliers.size(), 4u);
}

// Whatever the addresses of what a fit allocates, and whatever the number of threads.
TEST(Identify, GivesTheSameBitsAgain) {
  GeneratedProblem problem = Bounce();
  std::vector<Recording> recordings;
  GeneratedRandom random(7);
  for (const double speed : {-0.8, -0.4, 0.5, 0.9}) {
    problem.truth.bodies[0].velocity = {speed, 1};
    problem.recording.samples.clear();
    Measure(1e-3, 0, &random, &problem);
    recordings.push_back(problem.recording);
  }
  const auto numbers = [&](int threads) {
    IdentifyOptions options;
    options.threads = threads;
    const IdentifyReport report =
        Identify("event", problem.guess, recordings, {{Kind::kRestitution}, {Kind::kGravity, -1, 1}}, options);
    std::vector<double> all = {report.cost, report.correlation[0][1]};
    for (const Estimate& estimate : report.estimates) {
      all.insert(all.end(), {estimate.value, estimate.standard_error});
    }
    for (const std::vector<double>& initial : report.initial) all.insert(all.end(), initial.begin(), initial.end());
    return all;
  };
  const std::vector<double> first = numbers(1);
  std::vector<std::unique_ptr<double[]>> kept;  // leave gaps of other sizes on the heap
  for (int run = 0; run < 8; ++run) {
    for (int size = 1; size < 200; ++size) {
      auto block = std::make_unique<double[]>(static_cast<std::size_t>(random.Integer(1, 16)));
      if (random.Uniform(0, 1) < 0.5) kept.push_back(std::move(block));
    }
    EXPECT_EQ(numbers(1 + run % 2), first) << run;
  }
}

// Noise that nobody states is estimated.
TEST(Identify, EstimatesSigma) {
  GeneratedProblem problem = Bounce();
  for (Sample& sample : problem.recording.samples) sample.sigma = 0;
  const IdentifyReport report = Identify("event", problem.guess, {problem.recording}, {{Kind::kRestitution}});
  ASSERT_EQ(report.verdict, FitVerdict::kFits) << report.reason;
  EXPECT_NEAR(report.sigma, 1e-3, 2e-4);
  EXPECT_NEAR(report.estimates[0].value, 0.75, 5 * report.estimates[0].standard_error);
}

// Bounce() without a stated sigma.
GeneratedProblem BounceWithoutSigma() {
  GeneratedProblem problem = Bounce();
  for (Sample& sample : problem.recording.samples) sample.sigma = 0;
  return problem;
}

IdentifyReport FitRestitution(const GeneratedProblem& problem, RobustLoss loss = RobustLoss::kHuber) {
  return Identify("event", problem.guess, {problem.recording}, {{Kind::kRestitution}}, {.loss = loss});
}

// A wrong scene leaves residuals that are large, or systematic, whatever sigma is estimated from them.
TEST(Identify, WithoutSigmaTheResidualsAreTested) {
  const IdentifyReport right = FitRestitution(BounceWithoutSigma());
  EXPECT_EQ(right.verdict, FitVerdict::kFits) << right.reason;
  EXPECT_THAT(right.remarks, ElementsAre(testing::StartsWith("sigma was estimated: 0.00")));

  GeneratedProblem millimetres = BounceWithoutSigma();
  for (Sample& sample : millimetres.recording.samples) sample.position *= 1000;
  GeneratedProblem radius = BounceWithoutSigma();
  radius.guess.bodies[0].radius *= 3;
  GeneratedProblem gravity = BounceWithoutSigma();
  gravity.guess.gravity = {0, -4};
  for (const RobustLoss loss : {RobustLoss::kHuber, RobustLoss::kCauchy, RobustLoss::kNone}) {
    for (const GeneratedProblem& wrong : {millimetres, radius, gravity}) {
      const IdentifyReport report = FitRestitution(wrong, loss);
      EXPECT_EQ(report.verdict, FitVerdict::kContradicted) << report.reason;
      EXPECT_THAT(report.reason, HasSubstr("check the units"));
    }
  }
}

// Two of five samples are anywhere: the parameters are found all the same, by every robust loss, and none calls it a
// fit.
TEST(Identify, ManyOutliersGiveRobustLossesOneVerdict) {
  GeneratedProblem problem = BounceWithoutSigma();
  GeneratedRandom random(3);
  std::vector<Sample>& samples = problem.recording.samples;
  for (std::size_t i = 0; i < samples.size(); ++i) {
    if (i % 5 < 2) samples[i].position = {random.Uniform(-0.2, 1), random.Uniform(0, 1.2)};
  }
  for (const RobustLoss loss : {RobustLoss::kHuber, RobustLoss::kCauchy}) {
    const IdentifyReport report = FitRestitution(problem, loss);
    EXPECT_EQ(report.verdict, FitVerdict::kNotJudged) << report.reason;
    EXPECT_THAT(report.reason, HasSubstr("% of the samples are outliers"));
    EXPECT_NEAR(report.estimates[0].value, 0.75, 0.005);
  }
}

// A restitution above 1, which no fit may have, by less than what errors of the samples hide.
TEST(Identify, AParameterAtItsBoundHasNoStandardError) {
  GeneratedProblem problem = Bounce();
  problem.truth.contact.restitution = 1.0015;
  GeneratedRandom random(4);
  for (Sample& sample : problem.recording.samples) {
    const double x = random.Normal(), y = random.Normal();
    sample.position = BouncingBallAt(sample.time, problem.truth) + 1e-3 * Vec2d(x, y);
  }
  const IdentifyReport stated = FitRestitution(problem);
  EXPECT_EQ(stated.estimates[0].determination, Determination::kAtBound);
  EXPECT_EQ(stated.estimates[0].value, 1);
  EXPECT_EQ(stated.estimates[0].standard_error, 0);  // none
  EXPECT_EQ(stated.verdict, FitVerdict::kFits) << stated.reason;
  for (Sample& sample : problem.recording.samples) sample.sigma = 0;
  const IdentifyReport estimated = FitRestitution(problem);
  EXPECT_EQ(estimated.estimates[0].determination, Determination::kAtBound);
  EXPECT_EQ(estimated.verdict, FitVerdict::kNotJudged);
  EXPECT_THAT(estimated.reason, HasSubstr("restitution is at its bound"));
}

// A few of tests/campaign/identify_problems --coverage. Of so many intervals 95 % hold, with a standard deviation of
// 3 %; no model is contradicted by what it made.
class FewSamplesTest : public testing::TestWithParam<bool> {};
TEST_P(FewSamplesTest, IntervalsHold) {
  int intervals = 0, covered = 0;
  for (const int samples : {6, 8, 12}) {
    for (int seed = 1; seed <= 20; ++seed) {
      const GeneratedProblem problem = FewSamples(seed, samples, 0, GetParam());
      const IdentifyReport report = Identify("event", problem.guess, {problem.recording}, problem.unknowns);
      EXPECT_NE(report.verdict, FitVerdict::kContradicted) << samples << " samples, seed " << seed;
      for (const Estimate& estimate : report.estimates) {
        if (estimate.determination != Determination::kDetermined) continue;
        EXPECT_GT(estimate.standard_error, 0);
        const double truth = TrueValue(problem, estimate.unknown);
        ++intervals;
        covered += truth >= estimate.low && truth <= estimate.high;
      }
    }
  }
  EXPECT_GE(intervals, 50);
  EXPECT_GE(covered, 0.87 * intervals);
}
INSTANTIATE_TEST_SUITE_P(Identify, FewSamplesTest, testing::Bool(), ParameterName());

// A quarter of the samples, in these recordings up to half of them, are outliers.
TEST(Identify, OutliersDoNotContradictTheTrueModel) {
  for (const int seed : {6, 32, 35, 36, 44, 47}) {
    const GeneratedProblem problem = FewSamples(seed, 20, 0.25, /*states_sigma=*/true);
    const IdentifyReport report = Identify("event", problem.guess, {problem.recording}, problem.unknowns);
    EXPECT_THAT(report.verdict, testing::AnyOf(FitVerdict::kFits, FitVerdict::kNotJudged))
        << "seed " << seed << ": " << report.reason;
  }
}

// A third or a half of few samples are outliers, and without a stated sigma they look like noise.
TEST(Identify, ScatterOfManyOutliersIsNoNoise) {
  for (const int seed : {6, 23, 36}) {
    const GeneratedProblem problem = FewSamples(seed, 20, 0.25, /*states_sigma=*/false);
    const IdentifyReport report = Identify("event", problem.guess, {problem.recording}, problem.unknowns);
    EXPECT_EQ(report.verdict, FitVerdict::kNotJudged) << report.reason;
    EXPECT_THAT(report.reason, HasSubstr("% of the extent of the motion"));
  }
}

// In these recordings, outliers hide where the motion begins.
TEST(Identify, FindsMotionsBehindOutliers) {
  for (const bool states_sigma : {true, false}) {
    for (const int seed : {4, 19}) {
      const GeneratedProblem problem = FewSamples(seed, 40, 0.25, states_sigma);
      const IdentifyReport report = Identify("event", problem.guess, {problem.recording}, problem.unknowns);
      EXPECT_EQ(report.verdict, FitVerdict::kFits) << report.reason;
      for (const Estimate& estimate : report.estimates) {
        EXPECT_NEAR(estimate.value, TrueValue(problem, estimate.unknown), 4 * estimate.standard_error) << estimate.name;
      }
    }
  }
}

// Intervals beside those of a fit of the samples that are no outliers. A wrong sample may lie near the motion by
// chance.
TEST(Identify, IntervalsAreThoseOfTheSamplesWithoutOutliers) {
  for (const int seed : {1, 2, 3, 5}) {
    GeneratedProblem problem = FewSamples(seed, 60, 0.25, /*states_sigma=*/true);
    const IdentifyReport robust = Identify("event", problem.guess, {problem.recording}, problem.unknowns);
    std::vector<Sample> good;
    for (std::size_t i = 0; i < problem.outlier.size(); ++i) {
      if (!problem.outlier[i]) good.push_back(problem.recording.samples[i]);
    }
    problem.recording.samples = good;
    const IdentifyReport plain = Identify("event", problem.guess, {problem.recording}, problem.unknowns);
    for (std::size_t u = 0; u < 2; ++u) {
      const Estimate &one = robust.estimates[u], &other = plain.estimates[u];
      EXPECT_NEAR(one.value, other.value, other.standard_error) << "seed " << seed;
      EXPECT_NEAR(one.high - one.low, other.high - other.low, 0.1 * (other.high - other.low)) << "seed " << seed;
    }
  }
}

TEST(Identify, TooFewSamplesAreNotJudged) {
  for (const bool states_sigma : {false, true}) {
    const GeneratedProblem problem = FewSamples(1, 4, 0, states_sigma);
    const IdentifyReport report = Identify("event", problem.guess, {problem.recording}, problem.unknowns);
    EXPECT_EQ(report.verdict, FitVerdict::kNotJudged);
    EXPECT_THAT(report.reason, testing::StartsWith("too few samples to judge"));
    for (const Estimate& estimate : report.estimates) {
      EXPECT_EQ(estimate.determination, Determination::kUndetermined);
    }
  }
}

// Without the wrong sample, more than one motion passes by the other five.
TEST(Identify, AnOutlierAmongSixSamplesIsNotJudged) {
  for (const bool states_sigma : {false, true}) {
    for (const int seed : {117, 152}) {
      const GeneratedProblem problem = FewSamples(seed, 6, 0.1, states_sigma);
      const IdentifyReport report = Identify("event", problem.guess, {problem.recording}, problem.unknowns);
      EXPECT_EQ(report.verdict, FitVerdict::kNotJudged) << "seed " << seed;
      EXPECT_THAT(report.reason, HasSubstr("expected at least 6"));
    }
  }
}

// Six of twenty samples are wrong. For another motion, with sigma twice as large, one of them is no outlier.
TEST(Identify, OutliersDoNotPassForNoiseOfAWrongMotion) {
  const GeneratedProblem problem = FewSamples(95, 20, 0.25, /*states_sigma=*/false);
  const IdentifyReport report = Identify("event", problem.guess, {problem.recording}, problem.unknowns);
  EXPECT_EQ(report.verdict, FitVerdict::kFits) << report.reason;
  for (const SampleResidual& at : report.residuals) EXPECT_EQ(at.outlier, problem.outlier[at.sample]) << at.sample;
  for (const Estimate& estimate : report.estimates) {
    EXPECT_NEAR(estimate.value, TrueValue(problem, estimate.unknown), 3 * estimate.standard_error) << estimate.name;
  }
}

// Two balls of different restitution, as of one: the second recording misses the motion after the first impact.
TEST(Identify, OutliersThatFollowEachOtherAreNotJudged) {
  for (const bool states_sigma : {false, true}) {
    const GeneratedProblem problem = FewSamples(3, 60, 0, states_sigma);
    Scene other = problem.truth;
    other.contact.restitution -= 0.1;
    Recording second = problem.recording;
    for (Sample& sample : second.samples) {
      sample.position += BouncingBallAt(sample.time, other) - BouncingBallAt(sample.time, problem.truth);
    }
    const IdentifyReport report = Identify("event", problem.guess, {problem.recording, second}, problem.unknowns);
    EXPECT_EQ(report.verdict, FitVerdict::kNotJudged) << report.reason;
    EXPECT_THAT(report.reason, HasSubstr("outliers that follow each other"));
  }
}

// Against values of tables, which have three decimals.
TEST(Identify, IntervalsCountDegreesOfFreedom) {
  for (const auto& [degrees, quantile] : {std::pair{3.0, 3.182},
                                          std::pair{4.0, 2.776},
                                          std::pair{6.0, 2.447},
                                          std::pair{10.0, 2.228},
                                          std::pair{30.0, 2.042},
                                          std::pair{120.0, 1.980}}) {
    EXPECT_NEAR(StudentQuantile(degrees), quantile, 6e-3) << degrees;
  }
}

// In segments of two impacts or so each, the same.
TEST(Identify, LongRecordingsInSegments) {
  const GeneratedProblem problem = LongProblem(60);
  std::vector<std::string> said;
  IdentifyOptions options{.segment = 1};
  options.status = [&](const std::string& what) { said.push_back(what); };
  const IdentifyReport report = Identify("event", problem.guess, {problem.recording}, problem.unknowns, options);
  ASSERT_EQ(report.verdict, FitVerdict::kFits) << report.reason;
  EXPECT_GT(report.initial.size(), 50u);
  EXPECT_NEAR(report.estimates[0].value, 0.98, 5 * report.estimates[0].standard_error);
  EXPECT_LT(report.estimates[0].standard_error, 1e-3);
  EXPECT_THAT(said, testing::Contains(testing::StartsWith("start 1, 15 % of the samples, iteration 1, cost ")));
  EXPECT_THAT(said, testing::Contains(testing::StartsWith("confidence, iteration ")));
}

// An interrupted fit reports its best values.
TEST(Identify, StopsWhenAsked) {
  const GeneratedProblem problem = LongProblem(10);
  int asked = 0;
  IdentifyOptions options{.segment = 1};
  options.stop = [&] { return ++asked > 8; };
  const IdentifyReport report = Identify("event", problem.guess, {problem.recording}, problem.unknowns, options);
  EXPECT_EQ(report.verdict, FitVerdict::kInterrupted);
  EXPECT_EQ(report.initial.size(), 10u);
  EXPECT_LT(report.iterations, 20);
}

std::string ErrorIn(const std::string& csv) {
  const auto loaded = ParseRecording(csv, "ball.csv", Bounce().truth);
  const auto* error = std::get_if<RecordingError>(&loaded);
  return error == nullptr ? "" : error->ToString();
}

TEST(Recording, ErrorsNameTheLineAndWhatWasExpected) {
  const std::string header = "time,body,x,y,sigma\n";
  EXPECT_EQ(ErrorIn(header + "0.1,ball,0,1,0.001\n"), "");
  const std::pair<const char*, const char*> wrong[] = {
      {"0.1,ball,0,1,0.001\n2,ball,0,1,0.001\n",
       "ball.csv:3: time: found 2, expected 0 to the scene's duration, 1.5 s"},
      {"0.1,bal,0,1,0.001\n", "ball.csv:2: body: found 'bal', expected one of ball"},
      {"0.1,ball,nan,1,0.001\n", "ball.csv:2: x: found 'nan', expected a finite number"},
      {"0.1,ball,0,1e999,0.001\n", "ball.csv:2: y: found '1e999', expected a finite number"},
      {"0.1,ball,0,1,0\n", "ball.csv:2: sigma: found '0', expected a number > 0"},
      {"0.1,ball,0,1,0.001\n0.2,ball,0,1,\n", "ball.csv:3: found sigma in some rows, expected in all or none"},
      {"0.1,ball,0,1,1\n\n0.1,ball,0,2,1\n",
       "ball.csv:4: found 'ball' again at time 0.1, as in line 2; expected it once"},
      {"0.1,ball,0,1\n", "ball.csv: line 2: 4 fields, the header has 5"}};
  for (const auto& [rows, expected] : wrong) EXPECT_EQ(ErrorIn(header + rows), expected);
  EXPECT_THAT(ErrorIn("time,body,x\n0,ball,1\n"), HasSubstr("ball.csv:1: found no column y"));
  EXPECT_THAT(ErrorIn("time,body,x,y,z\n"), HasSubstr("ball.csv:1: found the column 'z'"));
  EXPECT_THAT(ErrorIn("time,body,x,y\n"), HasSubstr("found no samples"));
}

TEST(Unknowns, AreFoundByNameAndRefused) {
  const Scene scene = DropAndHit();
  const std::vector<Unknown> all = AllOf(scene);
  std::vector<std::string> names;
  for (const Unknown& unknown : all) names.push_back(NameOf(unknown, scene));
  EXPECT_THAT(names,
              ElementsAre("restitution",
                          "friction",
                          "gravity.x",
                          "gravity.y",
                          "mass.a",
                          "mass.b",
                          "force.a.x",
                          "force.a.y",
                          "force.b.y"));
  for (const char* wrong : {"",
                            "bounce",
                            "mass.c",
                            "gravity.z",
                            "force.a.z",
                            "offset.ceiling",
                            "position.a.x",
                            "restitution,restitution"}) {
    EXPECT_TRUE(std::holds_alternative<std::string>(ParseUnknowns(wrong, scene))) << wrong;
  }
}

// The coordinate of a number between two bounds, above one, below one, and without any.
TEST(Unknowns, KeepTheirBounds) {
  const double infinity = std::numeric_limits<double>::infinity();
  for (const auto& [low, high] :
       {std::pair{0.0, 1.0}, {-2.0, 3.0}, {0.1, infinity}, {-infinity, 0.9}, {-infinity, infinity}}) {
    FitUnknown unknown;
    unknown.low = low;
    unknown.high = high;
    for (const double value : {0.2, 0.7}) {
      const double at = unknown.ToCoordinate(value), width = 1e-6;
      EXPECT_NEAR(unknown.FromCoordinate(at), value, 1e-12);
      EXPECT_NEAR((unknown.FromCoordinate(at + width) - unknown.FromCoordinate(at - width)) / (2 * width),
                  unknown.SlopeAt(at),
                  1e-8);
    }
    for (const double far : {-30.0, 30.0}) {
      EXPECT_GE(unknown.FromCoordinate(far), low);
      EXPECT_LE(unknown.FromCoordinate(far), high);
    }
    if (!unknown.HasBounds()) continue;
    unknown.scale = high - low < 10 ? high - low : 1e-6;  // of a small number
    const double at_bound = unknown.FromCoordinate(unknown.CoordinateAtBoundNear(unknown.ToCoordinate(0.2)));
    EXPECT_NEAR(at_bound, unknown.BoundNear(at_bound), 2e-10 * unknown.scale);
  }
}

}  // namespace
}  // namespace saltus
