// One protocol: a simulator that knows single steps by the names of states, one that knows whole motions in rows of
// discs, and one that steps a hybrid system.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "blackbox/session.h"
#include "problems/hybrid_systems.h"
#include "programs/run_program.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using testing::HasSubstr;

// Semi-implicit steps of two discs of 1 kg with a radius of 0.2 m, and of a ball. The first argument is what it can do.
const char kSpeaker[] = R"(
import json, math, sys

def discs(h, x, u):
    a, b = x[:4], x[4:]
    for disc, force in ((a, u[:2]), (b, u[2:])):
        disc[2], disc[3] = disc[2] + h * force[0], disc[3] + h * force[1]
    distance = math.dist(a[:2], b[:2])
    n = [(a[j] - b[j]) / distance for j in (0, 1)]
    approach = sum(n[j] * (a[2 + j] - b[2 + j]) for j in (0, 1))
    if distance < 0.4 and approach < 0:
        for j in (0, 1):
            a[2 + j], b[2 + j] = a[2 + j] - approach * n[j], b[2 + j] + approach * n[j]
    for disc in (a, b):
        disc[0], disc[1] = disc[0] + h * disc[2], disc[1] + h * disc[3]
    return a + b

def ball(h, x, u, p):
    v = x[1] + h * (u[0] - p[0])
    return [x[0] + h * v, v]

def rows(x): return [x[:4], x[4:]]

for line in sys.stdin:
    q = json.loads(line)
    answer = {}
    if 'saltus' in q:
        answer = {'name': 'speaker', 'can': json.loads(sys.argv[1])}
        named = q.get('hybrid') or (q['names'] if 'names' in answer['can'] else None)
        states = named and named['modes'][0]['states']
    elif 'simulate' in q:
        s = q['simulate']
        x = sum(s['initial'], [])
        passed = [rows(x)]
        for k in range(s['steps']):
            x = discs(s['duration'] / s['steps'], x, s['control'][k if len(s['control']) > 1 else 0][0] + [0, 0])
            passed.append(rows(x))
        answer = {'final': rows(x)}
        if s.get('states'): answer['states'] = passed
    else:
        s = q['step']
        if named is None:
            answer = {'state': rows(discs(s['h'], sum(s['state'], []), sum(s['force'], [])))}
        elif states[0] == 'px striker':
            answer = {'mode': s['mode'], 'state': discs(s['h'], s['state'], s['control'])}
        else:
            h = s['h']
            answer = {'mode': s['mode'], 'state': ball(h, s['state'], s['control'], s['parameters'])}
            if s.get('jacobian'):
                answer['jacobian'] = [[1, h, h * h, -h * h, 0], [0, 1, h, -h, 0]]
    if 'id' in q: answer['id'] = q['id']
    print(json.dumps(answer), flush=True)
)";

std::string Speaking(const std::string& abilities) {
  return "python3 " + TempFileWith("speaker.py", kSpeaker) + " '" + abilities + "'";
}

// Forces differ from step to step, so that each must be that of its own step.
BlackBoxRequest MotionOf(const Scene& scene, BlackBoxRequest::Kind kind) {
  const int steps = kind == BlackBoxRequest::Kind::kStep ? 1 : scene.steps;
  BlackBoxRequest question{kind, steps, steps * scene.dt(), InitialState(scene), {}, {}};
  const int forces = kind == BlackBoxRequest::Kind::kStep ? 2 * scene.num_bodies() : scene.control_width() * steps;
  for (int i = 0; i < forces; ++i) question.control.push_back(0.3 + 0.1 * i);
  return question;
}

TEST(Protocol, StepsByNameMakeUpTheMotionsThatRowsGive) {
  Scene scene = ProblemScene("two_balls");
  scene.steps = 40;
  BlackBoxRequest states = MotionOf(scene, BlackBoxRequest::Kind::kSimulate);
  states.states = true;
  const std::vector<BlackBoxRequest> questions = {
      MotionOf(scene, BlackBoxRequest::Kind::kSimulate), states, MotionOf(scene, BlackBoxRequest::Kind::kStep)};
  CommandBox rows({"rows", Speaking(R"(["step", "states"])"), 1, 60});
  const std::vector<BlackBoxAnswer> expected = rows.Evaluate(scene, questions, nullptr);
  ASSERT_EQ(expected[0].error, "");
  EXPECT_NE(expected[0].final, questions[0].initial);
  for (const std::string abilities : {R"(["names", "states"])", R"(["names", "states", "simulate"])"}) {
    CommandBox names({"names", Speaking(abilities), 1, 60});
    const std::vector<BlackBoxAnswer> found = names.Evaluate(scene, questions, nullptr);
    for (std::size_t i = 0; i < questions.size(); ++i) {
      ASSERT_EQ(found[i].error, "");
      EXPECT_EQ(found[i].final, expected[i].final) << i;
      EXPECT_EQ(found[i].states, expected[i].states) << i;
    }
    EXPECT_TRUE(names.Describe(scene).step);
  }
}

// Steps by name are enough for an audit, with the same verdict and class as by rows.
TEST(Protocol, StepsByNameAreAudited) {
  Scene scene = ProblemScene("two_balls");
  scene.steps = 32;
  std::vector<ModelAudit> audits;
  for (const std::string abilities : {R"(["step"])", R"(["names"])"}) {
    const auto box = std::make_shared<CommandBox>(CommandOptions{"mine", Speaking(abilities), 2, 60});
    audits.push_back(
        AuditBlackBox(box, scene, ComputeExactGradient(scene), {.refinement = {.levels = 4, .samples = 3}}));
    ASSERT_TRUE(audits.back().gradient.ok()) << audits.back().gradient.reason;
  }
  EXPECT_TRUE(IsWrong(audits[0].verdict));
  EXPECT_EQ(audits[1].verdict, audits[0].verdict);
  ASSERT_TRUE(audits[0].recognition && audits[1].recognition);
  EXPECT_EQ(audits[0].recognition->contact_class, ContactClass::kImpulseAtStepBoundary);
  EXPECT_EQ(audits[1].recognition->contact_class, ContactClass::kImpulseAtStepBoundary);
  EXPECT_EQ(audits[1].gradient.loss, audits[0].gradient.loss);
}

TEST(Protocol, AHybridSystemIsSteppedByTheSameSimulator) {
  const HybridSystem system{BouncingBall()};
  const double x[] = {2, 0.5}, u[] = {0.25}, p[] = {9.75, 0.8};
  const SchemeStep step{.mode = 0, .t = 0, .h = 0.125, .x = x, .u = u, .p = p};
  for (const bool own : {false, true}) {
    CommandScheme scheme(system, {"ball", Speaking(own ? R"(["jacobian"])" : "[]"), 1, 60});
    EXPECT_EQ(scheme.HasJacobian(), own);
    double next[2], jacobian[2 * 5];
    std::string error;
    ASSERT_EQ(scheme.Step(step, next, jacobian, &error), 0) << error;
    EXPECT_EQ(next[1], 0.5 - 0.125 * 9.5);
    EXPECT_EQ(next[0], 2 + 0.125 * next[1]);
    const double expected[] = {1, 0.125, 0.015625, -0.015625, 0, 0, 1, 0.125, -0.125, 0};
    for (int i = 0; i < 10; ++i) EXPECT_NEAR(jacobian[i], expected[i], own ? 0 : 1e-9) << i;
  }
}

TEST(Protocol, AnAbilityThatDoesNotExistIsNamed) {
  CommandBox box({"mine", Speaking(R"(["step", "dance"])"), 1, 60});
  EXPECT_THAT(box.Describe(ProblemScene("two_balls")).error,
              HasSubstr("found '\"dance\"' in \"can\", expected some of"));
}

}  // namespace
}  // namespace saltus
