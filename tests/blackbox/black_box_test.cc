// Simulators that are commands: what is found of them, and what is said when they fail.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <fstream>
#include <future>
#include <optional>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include "blackbox/protocol.h"
#include "blackbox/protocol_server.h"
#include "blackbox/session.h"
#include "lines.h"
#include "programs/run_program.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using testing::HasSubstr;
using Json = ProtocolJson;

std::vector<BlackBoxRequest> Questions(const Scene& scene, int count) {
  std::vector<BlackBoxRequest> questions;
  for (int i = 1; i <= count; ++i) {
    questions.push_back(
        {BlackBoxRequest::Kind::kSimulate, i, 0.01 * i, InitialState(scene), InitialControl(scene, i), {}});
  }
  return questions;
}

// A model of the library, asked line by line in this process.
class Spoken final : public BlackBox {
 public:
  Spoken(const std::string& contact, const ServerCapabilities& offer) : name_(contact), offer_(offer) {}

  const std::string& name() const override { return name_; }
  BlackBoxTraits Describe(const Scene& scene) override {
    if (scene_ != scene) {
      speaker_ = std::make_unique<ProtocolServer>(name_, Precision::kDouble, offer_);
      traits_ = ReadHello(speaker_->ComputeAnswer(HelloLine(*(scene_ = scene))));
    }
    return traits_;
  }
  std::vector<BlackBoxAnswer> Evaluate(const Scene& scene, const std::vector<BlackBoxRequest>& questions,
                                       const StopRequest&) override {
    Describe(scene);
    std::vector<BlackBoxAnswer> answers;
    for (const BlackBoxRequest& question : questions) {
      num_steps_ += question.steps;
      answers.push_back(
          ReadAnswer(speaker_->ComputeAnswer(QuestionLine(scene, question, 1, traits_)), scene, question, 1, traits_));
    }
    return answers;
  }
  // It has taken in all.
  std::int64_t num_steps() const { return num_steps_; }

 private:
  std::int64_t num_steps_ = 0;
  std::string name_;
  std::optional<Scene> scene_;
  ServerCapabilities offer_;
  std::unique_ptr<ProtocolServer> speaker_;
  BlackBoxTraits traits_;
};

ModelAudit AuditFromOutside(const std::string& contact, const Scene& scene, const ServerCapabilities& offer) {
  AuditOptions options;
  options.attribution = false;
  return AuditBlackBox(std::make_shared<Spoken>(contact, offer), scene, ComputeExactGradient(scene), options);
}

// One model of each class, and those whose linearization is not that of their steps or whose steps are long.
TEST(BlackBox, ModelsHaveTheSameVerdictAndClassFromOutside) {
  for (const std::string problem : {"bounce_once", "ground_wall", "two_balls"}) {
    Scene scene = ProblemScene(problem);
    scene.steps = 120;  // with which each has its class
    AuditOptions options;
    options.attribution = false;
    for (const std::string contact :
         {"lcp", "direct", "toi_velocity", "pbd_brax", "lcp_pgs", "compliant_warp", "event"}) {
      const ModelAudit inside = AuditModel(contact, scene, Precision::kDouble, ComputeExactGradient(scene), options);
      const ModelAudit outside = AuditFromOutside(contact, scene, {.states = false});
      ASSERT_TRUE(outside.gradient.ok()) << contact << ": " << outside.gradient.reason;
      EXPECT_EQ(VerdictToString(outside.verdict), std::string(VerdictToString(inside.verdict)))
          << problem << " " << contact;
      EXPECT_EQ(ContactClassToString(outside.recognition->contact_class),
                std::string(ContactClassToString(inside.recognition->contact_class)))
          << problem << " " << contact << ": " << outside.recognition->words;
    }
  }
}

// Has no forces in its code.
class Unforced final : public BlackBox {
 public:
  const std::string& name() const override { return direct_.name(); }
  BlackBoxTraits Describe(const Scene& scene) override { return direct_.Describe(scene); }
  std::vector<BlackBoxAnswer> Evaluate(const Scene& scene, const std::vector<BlackBoxRequest>& asked,
                                       const StopRequest& stop) override {
    std::vector<BlackBoxRequest> questions = asked;
    for (BlackBoxRequest& question : questions) std::fill(question.control.begin(), question.control.end(), 0.0);
    return direct_.Evaluate(scene, questions, stop);
  }

 private:
  Spoken direct_{"direct", ServerCapabilities{false, false, false}};
};

TEST(BlackBox, AForceWithoutEffectInTheHeadOnImpactIsRemarked) {
  Scene scene = ProblemScene("ground_wall");
  scene.steps = 60;
  const auto remarks = [&](std::shared_ptr<BlackBox> box) {
    AuditOptions options;
    options.attribution = false;
    return AuditBlackBox(std::move(box), scene, ComputeExactGradient(scene), options).black_box->remarks;
  };
  EXPECT_THAT(remarks(std::make_shared<Unforced>()), testing::Contains(HasSubstr("force on the first disc")));
  EXPECT_THAT(remarks(std::make_shared<Spoken>("direct", ServerCapabilities{false, false, false})),
              testing::Not(testing::Contains(HasSubstr("force on the first disc"))));
}

// The values of engines with an impulse at a step boundary: whatever the engine, (0, -0.72, -0.22, -0.50) of
// (-0.40, -0.32, -0.50, -0.22), by differences of final states alone.
TEST(BlackBox, FinalStatesTellAnImpulseAtAStepBoundary) {
  const ModelAudit audit = AuditFromOutside("direct", ProblemScene("two_balls"), {false, false, false});
  ASSERT_TRUE(audit.gradient.ok()) << audit.gradient.reason;
  const double expected[] = {0, 0, -0.22, -0.22, -0.72, -0.72, -0.50, -0.50};
  for (int i = 0; i < 8; ++i) EXPECT_NEAR(audit.gradient.gradient.initial[i], expected[i], 0.01) << i;
  EXPECT_EQ(audit.recognition->contact_class, ContactClass::kImpulseAtStepBoundary);
  const BlackBoxFindings& found = *audit.black_box;
  EXPECT_EQ(found.precision_found, 53);
  EXPECT_EQ(found.motion, BlackBoxFindings::Motion::kConverges);
  EXPECT_NEAR(found.head_on->e, 1, 1e-9);
  EXPECT_NEAR(found.head_on->retention, 1, 1e-6);
  EXPECT_NEAR(found.head_on->velocity_feedback, 0, 1e-6);
  EXPECT_TRUE(IsWrong(audit.verdict));
}

// One that takes 1 ms for the 480 steps of the scene is audited within 20 s, on one core.
TEST(BlackBox, AVerdictTakesAFewThousandRollouts) {
  const Scene scene = ProblemScene("two_balls");
  const auto box = std::make_shared<Spoken>("direct", ServerCapabilities{false, false, false});
  EXPECT_TRUE(IsWrong(AuditBlackBox(box, scene, ComputeExactGradient(scene), {}).verdict));
  EXPECT_LT(box->num_steps(), 20'000 * 480);
}

// Keeps something of each answer for the next one.
class Leaking final : public BlackBox {
 public:
  explicit Leaking(double leak) : leak_(leak), honest_("event", {false, false, false}) {}

  const std::string& name() const override { return honest_.name(); }
  BlackBoxTraits Describe(const Scene& scene) override { return honest_.Describe(scene); }
  std::vector<BlackBoxAnswer> Evaluate(const Scene& scene, const std::vector<BlackBoxRequest>& questions,
                                       const StopRequest&) override {
    std::vector<BlackBoxAnswer> answers = honest_.Evaluate(scene, questions, nullptr);
    for (BlackBoxAnswer& answer : answers) {
      const std::vector<double> own = answer.final;
      kept_.resize(own.size());
      for (std::size_t i = 0; i < own.size(); ++i) answer.final[i] += leak_ * kept_[i];
      kept_ = own;
    }
    return answers;
  }

 private:
  double leak_;
  Spoken honest_;
  std::vector<double> kept_;
};

// The size in the first remark.
double DifferenceIn(const ModelAudit& audit) {
  const std::string before = "differ by ";
  if (audit.black_box->remarks.empty()) return 0;
  const std::string& remark = audit.black_box->remarks[0];
  const std::size_t at = remark.find(before);
  return at == std::string::npos ? 0 : std::stod(remark.substr(at + before.size()));
}

TEST(BlackBox, StateThatLeaksFromCallToCallIsSaidAndGetsNoVerdict) {
  const Scene scene = ProblemScene("two_balls");
  for (const double leak : {1e-3, 1e-7, 1e-9}) {
    const ModelAudit audit = AuditBlackBox(std::make_shared<Leaking>(leak), scene, ComputeExactGradient(scene), {});
    EXPECT_EQ(audit.verdict, Verdict::kUnknown) << leak;
    EXPECT_THAT(audit.VerdictReason(),
                HasSubstr("answers to the same question, with others asked in between, differ by"));
    EXPECT_GT(DifferenceIn(audit), 0.03 * leak);
    EXPECT_LT(DifferenceIn(audit), 10 * leak);
    EXPECT_EQ(audit.black_box->precision_found, 0);
  }
  // Rounding that depends on the past is said, and decides nothing.
  const ModelAudit rounding = AuditBlackBox(std::make_shared<Leaking>(1e-15), scene, ComputeExactGradient(scene), {});
  EXPECT_EQ(rounding.verdict, Verdict::kRight);
  EXPECT_GT(DifferenceIn(rounding), 0);
  EXPECT_LT(DifferenceIn(rounding), 1e-14);
  const ModelAudit none = AuditBlackBox(std::make_shared<Leaking>(0), scene, ComputeExactGradient(scene), {});
  EXPECT_THAT(none.black_box->remarks, testing::IsEmpty());
}

// With a clock that counts steps, 1 ms each.
TEST(BlackBox, AnAuditIsPlannedWithinTheTimeAllowed) {
  const Scene scene = ProblemScene("two_balls");
  const auto exact = ComputeExactGradient(scene);
  const auto audit_within = [&](double seconds, double* taken, std::vector<std::string>* said) {
    const auto box = std::make_shared<Spoken>("direct", ServerCapabilities{false, false, false});
    AuditOptions options;
    const AuditTime time{seconds, [&] { return 1e-3 * static_cast<double>(box->num_steps()); }};
    options.status = [&](const std::string& what) { said->push_back(what); };
    const ModelAudit audit = AuditBlackBox(box, scene, exact, options, time);
    *taken = time.clock();
    return audit;
  };
  double taken = 0;
  std::vector<std::string> said;
  const ModelAudit all = audit_within(0, &taken, &said);
  ASSERT_TRUE(IsWrong(all.verdict));
  EXPECT_GT(taken, 2000);
  EXPECT_THAT(said, testing::Contains(testing::MatchesRegex("refinement, about [0-9.e+]+ s")));
  EXPECT_EQ(all.refinement->quantities[0].levels.size(), 5u);

  for (const double seconds : {2000., 1000., 600.}) {
    const ModelAudit audit = audit_within(seconds, &taken, &said);
    EXPECT_TRUE(IsWrong(audit.verdict)) << seconds;
    EXPECT_LT(taken, 1.05 * seconds);
    EXPECT_GT(taken, 0.5 * seconds);
    EXPECT_EQ(audit.refinement->quantities[0].levels.size(), 4u) << seconds;
  }
  const ModelAudit none = audit_within(100, &taken, &said);
  EXPECT_EQ(none.verdict, Verdict::kUnknown);
  EXPECT_THAT(none.VerdictReason(), HasSubstr("more than is left of the 1e+02 s allowed"));
  EXPECT_LT(taken, 100);
}

// An impact whose time is resolved: differences of its final states are the exact gradient.
TEST(BlackBox, FinalStatesTellAResolvedImpact) {
  const ModelAudit audit = AuditFromOutside("event", ProblemScene("two_balls"), {false, false, false});
  EXPECT_EQ(audit.verdict, Verdict::kRight);
  EXPECT_EQ(audit.recognition->contact_class, ContactClass::kImpactTimeResolved);
  EXPECT_EQ(audit.black_box->motion, BlackBoxFindings::Motion::kExact);
  EXPECT_NEAR(audit.black_box->head_on->retention, -1, 1e-6);
  EXPECT_LT(audit.error->relative, 1e-6);
}

// A command that flies freely, until it has been asked so often.
const char kFaulty[] = R"(
import json, os, sys, time
fault, count, held = sys.argv[1], 0, []
def say(answer): print(json.dumps(answer), flush=True)
for line in sys.stdin:
    q = json.loads(line)
    if 'saltus' in q:
        say({'name': 'faulty'})
        continue
    count += 1
    s = q['simulate']
    T = s['duration']
    answer = {'id': q['id'], 'final': [[x + T * u, y + T * v, u, v] for x, y, u, v in s['initial']]}
    if count == 3:
        if fault == 'dies': sys.exit(3)
        if fault == 'killed': os.kill(os.getpid(), 9)
        if fault == 'cut':
            sys.stdout.write('{"id": 3, "fin')
            sys.stdout.flush()
            sys.exit(0)
        if fault == 'rubbish': print('rubbish ' * 10, flush=True)
        if fault == 'flood':
            sys.stdout.write('x' * 10_000_000)
            sys.stdout.flush()
            time.sleep(1000)
        if fault == 'nan': answer['final'][0][0] = float('nan')
        if fault == 'null': answer['final'][0][0] = None
        if fault == 'size': answer['final'].pop()
        if fault == 'other': answer['id'] = 77
        if fault == 'none': del answer['final']
        if fault == 'twice': say(answer)
        if fault == 'order':
            held = [answer]
            continue
    say(answer)
    for late in held: say(late)
    held = []
)";

TEST(BlackBox, FaultsAreSaidWithCommandRequestAndWhatCameBack) {
  const std::string script = TempFileWith("faulty.py", kFaulty);
  const struct {
    std::string fault, why;
  } cases[] = {{"dies", "ended with exit code 3"},
               {"killed", "killed by signal 9"},
               {"cut", "in the middle of the line '{\"id\": 3, \"fin'"},
               {"rubbish", "found 'rubbish rubbish"},
               {"flood", "begins with 'xxxx"},
               {"nan", "not finite"},
               {"null", "found 'null' among them"},
               {"size", "found a list of 1 in place of a list of 2"},
               {"other", "found id '77', expected \"id\": 3"},
               {"none", "expected \"final\" in it"},
               {"order", "found id '4', expected \"id\": 3"}};
  const Scene scene = ProblemScene("two_balls");
  for (const auto& [fault, why] : cases) {
    CommandBox box({"faulty", "exec python3 " + script + " " + fault, 1, 60});
    const std::vector<BlackBoxAnswer> answers = box.Evaluate(scene, Questions(scene, 8), nullptr);
    EXPECT_TRUE(answers[1].error.empty()) << answers[1].error;
    EXPECT_NEAR(answers[1].final[0], -2, 1e-12);
    EXPECT_THAT(answers[2].error, HasSubstr(why)) << fault;
    EXPECT_THAT(answers[2].error, HasSubstr("faulty.py " + fault)) << fault;
    EXPECT_THAT(answers[2].error, HasSubstr("request 3 (simulate of 3 steps)")) << fault;
    EXPECT_EQ(answers[7].error, answers[2].error) << fault;
    EXPECT_EQ(box.Describe(scene).error, answers[2].error) << fault;
  }
}

TEST(BlackBox, AnAnswerThatNobodyAskedForIsAFault) {
  const Scene scene = ProblemScene("two_balls");
  CommandBox box({"faulty", "exec python3 " + TempFileWith("twice.py", kFaulty) + " twice", 1, 60});
  EXPECT_THAT(box.Evaluate(scene, Questions(scene, 8), nullptr)[3].error,
              HasSubstr("found id '3', expected \"id\": 4"));
}

TEST(BlackBox, SilenceIsAnErrorAfterTheTimeAllowed) {
  const Scene scene = ProblemScene("two_balls");
  const struct {
    std::string command, why;
  } cases[] = {
      {"sleep 1000", "the greeting: silent for 2 s"},
      {"read a; echo '{}'; sleep 1000", "request 1 (simulate of 1 steps): silent for 2 s"},
      {"read a; echo '{}'; printf '{\"id\": 1, \"fin'; sleep 1000", "silent for 2 s after '{\"id\": 1, \"fin'"}};
  std::vector<std::future<std::string>> errors;  // of all at once, as each takes the time allowed
  for (const auto& silent : cases) {
    errors.push_back(std::async(std::launch::async, [&scene, &silent] {
      return CommandBox({"silent", silent.command, 1, 2}).Evaluate(scene, Questions(scene, 1), nullptr)[0].error;
    }));
  }
  for (std::size_t i = 0; i < errors.size(); ++i)
    EXPECT_THAT(errors[i].get(), HasSubstr(cases[i].why)) << cases[i].command;
}

TEST(BlackBox, AGreetingThatIsNoneIsAnError) {
  const Scene scene = ProblemScene("two_balls");
  const struct {
    std::string command, why;
  } cases[] = {{"no_such_command_here", "ended with exit code 127"},
               {"true", "the greeting: ended with exit code 0"},
               {"echo hello", "found 'hello', expected an object"},
               {"echo '{\"can\": [\"fly\"]}'", "found '\"fly\"' in \"can\""},
               {"echo '{\"can\": [\"step\"], \"grid_steps\": 0}'", "expected a whole number in 1..1000"}};
  for (const auto& [command, why] : cases) {
    CommandBox box({"wrong", command, 1, 60});
    EXPECT_THAT(box.Describe(scene).error, HasSubstr(why)) << command;
  }
}

// Whether a process has gone, with nothing left of it, within a time that is long for any machine.
bool HasGone(pid_t pid) {
  for (int i = 0; i < 6000; ++i) {
    if (kill(pid, 0) < 0 && errno == ESRCH) return true;
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  return false;
}

std::vector<pid_t> ProcessesIn(const std::string& file) {
  std::ifstream in(file);
  std::vector<pid_t> found;
  for (pid_t pid = 0; in >> pid;) found.push_back(pid);
  return found;
}

TEST(BlackBox, NothingIsLeftOfACommand) {
  const Scene scene = ProblemScene("two_balls");
  const std::string file = TempFile("processes");
  {
    CommandBox box({"lasting", "sleep 1000 & echo $$ $! >" + file + "; read a; echo '{}'; read a; wait", 1, 60});
    EXPECT_EQ(box.Describe(scene).error, "");
  }
  const std::vector<pid_t> processes = ProcessesIn(file);
  ASSERT_EQ(processes.size(), 2u);
  for (const pid_t process : processes) EXPECT_TRUE(HasGone(process));
}

// Tries a command that greets and is then silent, and one that is silent from the start.
TEST(BlackBox, AnInterruptOrAKillLeavesNoChildBehind) {
  const std::pair<std::string, std::string> cases[] = {{"INT", "echo '{}'"}, {"INT", "true"}, {"KILL", "echo '{}'"}};
  for (const auto& [signal_name, greeting] : cases) {
    const std::string file = TempFile("children_" + std::string(signal_name));
    std::remove(file.c_str());
    const std::string box =
        TempFileWith("box.sh", "echo $$ >>" + file + "\nread a\n" + greeting + "\nread a\nsleep 1000\n");
    const Outcome outcome =
        RunCommand("env --default-signal=INT " + BuildFolder() + "/bin/saltus_audit" + SceneFlag("two_balls") +
                   "--progress=none --simulate='sh " + box + "' & " + "p=$!; while [ ! -s " + file +
                   " ]; do sleep 0.05; done; kill -" + signal_name + " $p; wait $p; echo exit code $?");
    EXPECT_THAT(outcome.output, HasSubstr(signal_name == "INT" ? "exit code 1\n" : "exit code 137\n"))
        << outcome.errors;
    ASSERT_FALSE(ProcessesIn(file).empty());
    for (const pid_t process : ProcessesIn(file)) EXPECT_TRUE(HasGone(process)) << signal_name;
  }
}

// The simulator that the documentation shows: symplectic Euler, and the impulse of two equal discs when they overlap.
std::string SimulatorOfPage() {
  const std::string page = ContentsOf(SourceFolder() + "/docs/how-to/audit-a-simulator.md");
  const std::size_t begin = page.find("import json\nimport math\n");
  return page.substr(begin, page.find("```", begin) - begin);
}

TEST(BlackBox, TheSimulatorOfThePageIsAudited) {
  const std::string script = TempFileWith("mine.py", SimulatorOfPage());
  const Outcome outcome = RunProgram("saltus_audit" + SceneFlag("two_balls") +
                                     "--steps=60 --progress=none --json --simulate='ten=" + "python3 " + script +
                                     "' --simulate=gone=no_such_command_here");
  EXPECT_EQ(outcome.exit_code, 1) << outcome.errors;  // for the one that is gone
  const Json audits = Json::parse(outcome.output)["audits"];
  ASSERT_EQ(audits.size(), 2u);
  const Json& ten = audits[0];
  EXPECT_EQ(ten["contact"], "ten");
  EXPECT_EQ(ten["black_box"], true);
  EXPECT_EQ(ten["class"], "impulse at a step boundary");
  EXPECT_EQ(ten["motion"], "converges");
  EXPECT_EQ(ten["precision_found"], 53);
  EXPECT_NEAR(ten["e"].get<double>(), 1, 1e-9);
  EXPECT_NEAR(ten["keep"].get<double>(), 1, 1e-6);
  EXPECT_NEAR(ten["feed"].get<double>(), 0, 1e-6);
  EXPECT_THAT(ten["verdict"].get<std::string>(), HasSubstr("wrong"));
  EXPECT_EQ(audits[1]["termination"], "failed");
  EXPECT_THAT(audits[1]["reason"].get<std::string>(), HasSubstr("exit code 127"));
}

// The simulator of the page, whose impulse also takes away a fifth of the overlap within a step. On the median the
// impact is half a step before the impulse, so the overlap is what the discs close in half a step. A displacement d
// before the impact changes the speed of separation by -0.2 d / h from the impulse on: relative to a change of speed at
// the impact, that is 0.1 d more of displacement.
TEST(BlackBox, WhatAnOverlapFeedsIntoVelocitiesIsMeasured) {
  std::string script = SimulatorOfPage();
  const std::string impulse = "if distance < 0.4 and approach < 0:\n";
  script.insert(script.find(impulse) + impulse.size(), "            approach -= 0.1 * (0.4 - distance) / h\n");
  const auto box =
      std::make_shared<CommandBox>(CommandOptions{"fed", "exec python3 " + TempFileWith("fed.py", script), 1, 60});
  Scene scene = ProblemScene("two_balls");
  scene.steps = 60;
  AuditOptions options;
  options.attribution = false;
  const ModelAudit audit = AuditBlackBox(box, scene, ComputeExactGradient(scene), options);
  ASSERT_TRUE(audit.black_box && audit.black_box->head_on);
  EXPECT_NEAR(audit.black_box->head_on->e, 1.1, 1e-6);
  EXPECT_NEAR(audit.black_box->head_on->retention, 1.1, 1e-6);
  EXPECT_NEAR(audit.black_box->head_on->velocity_feedback, -0.2, 1e-6);
}

TEST(BlackBox, AGradientThatAgreesWithDifferencesAndIsWrongIsSaidLoudly) {
  const std::string simulate = BuildFolder() + "/bin/saltus_simulate --contact=direct";
  const Outcome outcome =
      RunProgram("saltus_audit" + SceneFlag("two_balls") + "--progress=none --json --simulate='" + simulate + "'");
  EXPECT_EQ(outcome.exit_code, 0) << outcome.errors;
  const Json audit = Json::parse(outcome.output)["audits"][0];
  EXPECT_EQ(audit["contact"], "saltus_simulate");
  EXPECT_EQ(audit["agrees_with_differences"], true);
  EXPECT_EQ(audit["first_wrong_step"], 331);
  EXPECT_THAT(audit["findings"][0].get<std::string>(), HasSubstr("agrees with differences, and is wrong"));
  // Its derivatives by parameters, which it is asked for by name, agree with those of scenes with other parameters.
  ASSERT_TRUE(audit.contains("parameters"));
  std::set<std::string> right;
  for (const Json& parameter : audit["parameters"]) {
    if (parameter["verdict"] == "right") right.insert(parameter["name"].get<std::string>());
  }
  EXPECT_TRUE(right.contains("restitution") && right.contains("mass.striker") && right.contains("gravity.x"));
}

// In a sweep it is one more contact model; one that fails is a row with the reason.
TEST(BlackBox, SweepsTakeSimulators) {
  const std::string simulate = BuildFolder() + "/bin/saltus_simulate --offer=gradient --contact=direct_toi";
  const Outcome outcome = RunProgram("saltus_sweep" + SceneFlag("two_balls") +
                                     "--solver=none --sweep=steps=60,120 --progress=none --contact=direct_toi "
                                     "--simulate='outside=" +
                                     simulate + "' --simulate=gone=no_such_command_here");
  std::vector<std::string> rows;
  std::stringstream text(outcome.output);
  for (std::string line; std::getline(text, line);) rows.push_back(line);
  ASSERT_EQ(rows.size(), 7u) << outcome.output << outcome.errors;  // with the header
  // After steps and contact: loss, norms of the gradient, its error, and the reason.
  const auto numbers = [](const std::string& row) {
    std::vector<double> found;
    std::stringstream cells(row);
    int column = 0;
    for (std::string cell; std::getline(cells, cell, ',') && column < 7; ++column) {
      if (column >= 2) found.push_back(std::stod(cell));
    }
    return found;
  };
  for (int i : {1, 4}) {
    EXPECT_THAT(rows[i + 1], HasSubstr("outside"));
    EXPECT_THAT(numbers(rows[i + 1]), testing::Pointwise(testing::DoubleNear(1e-12), numbers(rows[i])));
    EXPECT_THAT(rows[i + 2], HasSubstr("exit code 127"));
  }
}

TEST(BlackBox, RefusesWrongFlags) {
  const struct {
    std::string flags, why;
  } cases[] = {{"--simulate=a=x --simulate=a=y", "two of the name 'a'"},
               {"--simulate=a=", "expected [NAME=]COMMAND"},
               {"--simulate=@no_such_file", "no_such_file"},
               {"--simulate=true --surrogate=smoothed_zeroth", "has no surrogate gradients"},
               {"--simulate=true --simulate_seconds=0", "--simulate_seconds must be positive"}};
  for (const auto& [flags, why] : cases) {
    const Outcome outcome = RunProgram("saltus_audit" + SceneFlag("two_balls") + flags);
    EXPECT_EQ(outcome.exit_code, 2) << flags;
    EXPECT_THAT(outcome.errors, HasSubstr(why)) << flags;
  }
}

}  // namespace
}  // namespace saltus
