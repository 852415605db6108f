// Mechanical systems with contacts against exact values, which were computed in 60 digits by Taylor series and
// differentiated by variational equations and by differences.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <numbers>
#include <string>
#include <vector>

#include "hybrid/mechanical_problems.h"
#include "problems/hybrid_systems.h"
#include "reference_values.h"
#include "saltus/hybrid/hybrid_simulator.h"
#include "saltus/hybrid/mechanical_system.h"

namespace saltus {
namespace {

using nlohmann::json;

const json& References() { return ReferenceFile("mechanical_references.json"); }

// Relative errors that are allowed: of event times, states and impulses; of derivatives, of the largest of a column.
struct Tolerance {
  double state = 1e-10;
  double derivative = 1e-8;
};

// The start as a function of the parameters, and its derivative by them.
struct Start {
  std::vector<double> state;
  std::vector<std::vector<double>> by_parameter;  // of each component
};
template <typename System, typename Function>
Start StartOf(const std::vector<double>& p, const Function& function) {
  using Jet = ceres::Jet<double, System::kNumParameters>;
  std::array<Jet, System::kNumParameters> jets;
  for (int i = 0; i < System::kNumParameters; ++i) jets[i] = Jet(p[i], i);
  const auto x = function(jets.data());
  Start start;
  for (const Jet& component : x) {
    start.state.push_back(component.a);
    start.by_parameter.emplace_back(component.v.data(), component.v.data() + System::kNumParameters);
  }
  return start;
}

// A problem of the file, simulated.
class Problem {
 public:
  template <typename System>
  Problem(const std::string& name, System, MechanicalOptions options = {})
      : Problem(
            name, System(), [](const auto*) { return 0; }, options) {}

  // `start`: the state at the start from the parameters, of problems whose start the file does not have.
  template <typename System, typename Function>
  Problem(const std::string& name, System system, const Function& function, MechanicalOptions options = {})
      : reference_(References().at(name)),
        name_(name),
        system_(std::move(system), options),
        simulator_(system_.hybrid(), {.tolerance = 1e-14}) {
    const json& data = reference_.at("data");
    const json& values = data.at("parameters");
    for (const char* parameter : System::kParameterNames) {
      names_.push_back(parameter);
      input_.parameters.push_back(values.contains(parameter) ? Number(values[parameter]) : 0.0);
    }
    if constexpr (std::is_same_v<decltype(function(static_cast<const double*>(nullptr))), int>) {
      for (const char* part : {"q0", "v0"}) {
        for (const json& value : data.at(part)) start_.state.push_back(Number(value));
      }
      start_.by_parameter.assign(start_.state.size(), std::vector<double>(names_.size(), 0.0));
    } else {
      start_ = StartOf<System>(input_.parameters, function);
    }
    input_.initial = start_.state;
    input_.duration = Number(data.at("T"));
    if (data.contains("u")) {
      for (const json& value : data["u"]) {
        for (const json& component : value.is_array() ? value : json::array({value})) {
          input_.control.push_back(Number(component));
        }
      }
      input_.num_intervals = static_cast<int>(input_.control.size()) / System::kNumControls;
    }
    const std::vector<double> no_control(System::kNumControls, 0.0);
    const std::span<const double> u =
        std::span(input_.control.empty() ? no_control : input_.control).first(System::kNumControls);
    const MechanicalSystem::Start mode = system_.FindMode(input_.initial, u, input_.parameters);
    EXPECT_GE(mode.mode, 0) << mode.reason;
    if (mode.mode < 0) return;
    input_.mode = mode.mode;
    if (data.contains("mode")) {
      EXPECT_EQ(system_.hybrid().ModeName(input_.mode), data["mode"].get<std::string>());
      input_.mode = system_.Mode(data["mode"].get<std::string>());
    }
    done_ = simulator_.Rollout(input_);
    EXPECT_TRUE(done_) << simulator_.FailureReason();
    if (!done_) return;
    sensitivity_ = simulator_.Sensitivity();
    report_ = system_.Examine(simulator_, input_);
  }

  // Final state, events, impulses and all derivatives. Of problems whose bounces accumulate, events up to then.
  void ExpectReference(Tolerance tolerance = {}) {
    ASSERT_TRUE(done_);
    ExpectFinal(tolerance);
    ExpectEvents(tolerance);
    ExpectConsistent();
  }

  HybridSimulator& simulator() { return simulator_; }
  const MechanicalReport& report() const { return report_; }
  const MechanicalSystem& system() const { return system_; }
  const HybridInput& input() const { return input_; }
  const json& reference() const { return reference_; }

 private:
  // The derivative of a row of sensitivities by a quantity of the file.
  double By(const double* row, const std::string& name) const {
    const int n0 = static_cast<int>(input_.initial.size());
    const int num_controls = system_.hybrid().num_controls();
    const int controls = input_.num_intervals * num_controls;
    if (name == "T") return row[sensitivity_.columns - 1];
    const auto parameter = std::find(names_.begin(), names_.end(), name);
    if (parameter != names_.end()) {
      const auto index = parameter - names_.begin();
      double sum = row[n0 + controls + index];
      for (int i = 0; i < n0; ++i) sum += row[i] * start_.by_parameter[i][index];
      return sum;
    }
    if (const size_t under = name.find('_'); name[0] == 'u' && under != std::string::npos) {
      const int component = std::stoi(name.substr(1, under)) - 1, interval = std::stoi(name.substr(under + 1));
      return row[n0 + interval * num_controls + component];
    }
    const int index = std::stoi(name.substr(1)) - 1;
    return row[name[0] == 'q' ? index : n0 / 2 + index];
  }

  void ExpectFinal(const Tolerance& tolerance) {
    const std::span<const double> state = simulator_.final_state();
    const json& expected = reference_.at("state_at_T");
    ASSERT_EQ(expected.size(), state.size());
    double size = 0;
    for (const json& value : expected) size = std::max(size, std::abs(Number(value)));
    for (size_t i = 0; i < state.size(); ++i) {
      EXPECT_NEAR(state[i], Number(expected[i]), tolerance.state * std::max(size, 1e-3)) << "component " << i;
    }
    EXPECT_EQ(system_.hybrid().ModeName(simulator_.final_mode()), reference_.at("modes_last").get<std::string>());
    // With the intervals of the control, the duration stretches them.
    json table = reference_.at("derivatives");
    table["T"] =
        reference_.contains("dx_dT_intervals_stretch") ? reference_["dx_dT_intervals_stretch"] : reference_.at("dx_dT");
    // The box lies on the ground at the start, so that its height is b.
    if (name_ == "P5s") table["b"][1] = "1";
    std::vector<double> largest(state.size(), 1e-3);
    for (const auto& [name, row] : table.items()) {
      for (size_t i = 0; i < state.size(); ++i) largest[i] = std::max(largest[i], std::abs(Number(row[i])));
    }
    for (const auto& [name, row] : table.items()) {
      for (size_t i = 0; i < state.size(); ++i) {
        EXPECT_NEAR(By(&sensitivity_.final_state[i * sensitivity_.columns], name),
                    Number(row[i]),
                    tolerance.derivative * largest[i])
            << "component " << i << " by " << name;
      }
    }
  }

  void ExpectEvents(const Tolerance& tolerance) {
    const json& expected = reference_.at("events");
    const std::vector<HybridEvent>& events = simulator_.events();
    size_t impact = 0, compared = 0;
    for (size_t i = 0; i < expected.size(); ++i) {
      const json& event = expected[i];
      const auto kind = event.at("kind").get<std::string>();
      if (kind == "accumulated") {
        ExpectAccumulation(event, tolerance);
        compared = events.size();
        continue;
      }
      // The last event of those that accumulate has been found from its time.
      size_t at = i;
      if (compared == events.size()) {
        while (at + 1 < events.size() && std::abs(events[at].time - Number(event.at("t"))) > 1e-6) ++at;
      }
      ASSERT_LT(at, events.size());
      const std::string what = kind + " at " + event.at("t").get<std::string>();
      const std::map<std::string, std::string> names = {
          {"hit", "hit"}, {"off", "off"}, {"vt0", "stop"}, {"slip+", "break+"}, {"slip-", "break-"}};
      const std::string guard = names.at(kind) + " " + event.at("contact").get<std::string>();
      EXPECT_EQ(system_.hybrid().GuardName(events[at].mode, events[at].guard), guard) << what;
      EXPECT_EQ(system_.hybrid().ModeName(events[at].next_mode), event.at("mode").get<std::string>()) << what;
      EXPECT_NEAR(events[at].time, Number(event.at("t")), tolerance.state * input_.duration) << what;
      if (event.contains("x_before")) {
        ExpectNumbers(events[at].before, event["x_before"], tolerance.state, what + " before");
      }
      if (event.contains("x_after")) {
        ExpectNumbers(events[at].after, event["x_after"], tolerance.state, what + " after");
      }
      double largest = 1e-3;
      for (const auto& [name, value] : event.at("dt").items()) largest = std::max(largest, std::abs(Number(value)));
      for (const auto& [name, value] : event.at("dt").items()) {
        EXPECT_NEAR(By(sensitivity_.times[at].data(), name), Number(value), tolerance.derivative * largest)
            << what << ", its time by " << name;
      }
      if (kind != "hit") continue;
      ASSERT_LT(impact, report_.impacts.size());
      ExpectImpact(report_.impacts[impact++], event, tolerance, what);
    }
    if (compared == 0) {
      EXPECT_EQ(events.size(), expected.size());
    }
  }

  void ExpectImpact(const MechanicalImpact& impact, const json& event, const Tolerance& tolerance,
                    const std::string& what) {
    if (event.contains("dE")) {
      EXPECT_NEAR(impact.energy, Number(event["dE"]), tolerance.state * std::max(1.0, std::abs(impact.energy))) << what;
    }
    if (!event.contains("impulses")) return;
    for (const auto& [name, values] : event["impulses"].items()) {
      const std::vector<std::string>& names = system_.functions().layout().contact_names;
      const auto index = static_cast<int>(std::find(names.begin(), names.end(), name) - names.begin());
      const auto contact = std::find_if(impact.contacts.begin(), impact.contacts.end(), [&](const auto& candidate) {
        return candidate.contact == index;
      });
      ASSERT_NE(contact, impact.contacts.end()) << what;
      const auto expect = [&](const char* key, double found) {
        if (values.contains(key)) {
          EXPECT_NEAR(found, Number(values[key]), tolerance.state * std::max(1.0, std::abs(found))) << what << key;
        }
      };
      expect("pN", contact->normal_impulse);
      expect("pT", contact->tangential_impulse);
      expect("vn-", contact->normal_before);
      expect("vn+", contact->normal_after);
      expect("vt-", contact->tangential_before);
      expect("vt+", contact->tangential_after);
    }
  }

  // Bounces end in an impact without restitution; t_inf is the time at which they would have ended.
  void ExpectAccumulation(const json& event, const Tolerance& tolerance) {
    ASSERT_EQ(report_.accumulations.size(), 1u);
    const MechanicalImpact& impact = report_.impacts[report_.accumulations[0]];
    EXPECT_NEAR(impact.accumulates_at, Number(event.at("t")), tolerance.state * input_.duration);
  }

  static void ExpectNumbers(std::span<const double> found, const json& expected, double tolerance,
                            const std::string& what) {
    ASSERT_EQ(found.size(), expected.size()) << what;
    double size = 1e-3;
    for (const json& value : expected) size = std::max(size, std::abs(Number(value)));
    for (size_t i = 0; i < found.size(); ++i) {
      EXPECT_NEAR(found[i], Number(expected[i]), tolerance * size) << what << " " << i;
    }
  }

  // The adjoint against the forward sweep; gaps and speeds of closed contacts.
  void ExpectConsistent() {
    const size_t n = simulator_.final_state().size();
    const HybridSensitivity without = simulator_.Sensitivity(/*by_parameters=*/false);
    for (size_t i = 0; i < n; ++i) {
      std::vector<double> cotangent(n);
      cotangent[i] = 1;
      const HybridGradient gradient = simulator_.Adjoint(cotangent);
      HybridCotangent of_others;
      of_others.final_state = cotangent;
      of_others.by_parameters = false;
      const HybridGradient others = simulator_.Adjoint(of_others);
      EXPECT_THAT(others.parameters, testing::Each(0.0));
      EXPECT_EQ(others.parameters.size(), gradient.parameters.size());
      std::vector<double> all = gradient.initial;
      all.insert(all.end(), gradient.control.begin(), gradient.control.end());
      all.insert(all.end(), gradient.parameters.begin(), gradient.parameters.end());
      all.push_back(gradient.duration);
      const double* row = &sensitivity_.final_state[i * sensitivity_.columns];
      const double* row_without = &without.final_state[i * sensitivity_.columns];
      double size = 1e-3;
      for (const double entry : all) size = std::max(size, std::abs(entry));
      const size_t first = gradient.initial.size() + gradient.control.size();
      for (size_t j = 0; j < all.size(); ++j) {
        EXPECT_NEAR(all[j], row[j], 1e-10 * size) << i << " by column " << j;
        const bool of_parameter = j >= first && j < first + gradient.parameters.size();
        EXPECT_NEAR(row_without[j], of_parameter ? 0.0 : row[j], 1e-12 * size) << i << " by column " << j;
      }
      for (size_t j = 0; j < first; ++j) {
        const double other = j < others.initial.size() ? others.initial[j] : others.control[j - others.initial.size()];
        EXPECT_NEAR(other, all[j], 1e-12 * size) << i << " by column " << j;
      }
      EXPECT_NEAR(others.duration, gradient.duration, 1e-12 * size);
    }
  }

  const json& reference_;
  std::string name_;
  MechanicalSystem system_;
  HybridSimulator simulator_;
  std::vector<std::string> names_;
  Start start_;
  HybridInput input_;
  bool done_ = false;
  HybridSensitivity sensitivity_;
  MechanicalReport report_;
};

TEST(MechanicalReference, PendulumBetweenWalls) { Problem("P1", PendulumBetweenWalls()).ExpectReference(); }
TEST(MechanicalReference, CartPole) { Problem("P2", CartPoleWithStops()).ExpectReference(); }
TEST(MechanicalReference, DoublePendulumThatSlides) { Problem("P3a", DoublePendulum()).ExpectReference(); }
TEST(MechanicalReference, DoublePendulumThatSticks) { Problem("P3b", DoublePendulum()).ExpectReference(); }
TEST(MechanicalReference, DoublePendulumThatStaysOnThePlane) { Problem("P3c", DoublePendulum()).ExpectReference(); }
TEST(MechanicalReference, DoublePendulumWhoseBouncesAccumulate) {
  Problem("P3z", DoublePendulum()).ExpectReference({.state = 1e-8});
}
TEST(MechanicalReference, TossedBox) { Problem("P4", Box<4>()).ExpectReference(); }
TEST(MechanicalReference, LargerTossedBox) { Problem("P4r", Box<4>()).ExpectReference(); }
TEST(MechanicalReference, BoxThatSlidesDown) { Problem("P5s", Box<2>()).ExpectReference(); }

TEST(MechanicalReference, BoxThatTips) {
  Problem("P5t", Box<2>(), [](const auto* p) {
    using T = std::remove_cvref_t<decltype(*p)>;
    using std::cos, std::sin;
    const T th = -p[7];
    return std::array<T, 6>{
        -p[1] * cos(th) - p[2] * sin(th), -p[1] * sin(th) + p[2] * cos(th), th, T(0.0), T(0.0), T(0.0)};
  }).ExpectReference();
}

TEST(MechanicalReference, RockingBlock) {
  Problem("P7", Box<2>(), [](const auto* p) {
    using T = std::remove_cvref_t<decltype(*p)>;
    using std::cos, std::sin;
    const T th = p[7];
    return std::array<T, 6>{
        p[1] * cos(th) - p[2] * sin(th), p[1] * sin(th) + p[2] * cos(th), th, T(0.0), T(0.0), T(0.0)};
  }).ExpectReference();
}

TEST(MechanicalReference, SlidingRod) {
  Problem("P6a", SlidingRod(), [](const auto* p) {
    using T = std::remove_cvref_t<decltype(*p)>;
    using std::cos, std::sin;
    return std::array<T, 6>{
        p[1] * cos(p[5]), p[1] * sin(p[5]), p[5], p[7] - p[1] * sin(p[5]) * p[6], p[1] * cos(p[5]) * p[6], p[6]};
  }).ExpectReference();
}

TEST(MechanicalReference, BallInNonlinearCoordinate) {
  Problem("P9a", BallInNonlinearCoordinate()).ExpectReference({.state = 1e-8});
}
TEST(MechanicalReference, BallOnIncline) { Problem("P9b", BallOnIncline()).ExpectReference({.state = 1e-8}); }
TEST(MechanicalReference, Bowl) { Problem("P9c", Bowl()).ExpectReference({.state = 1e-8}); }

TEST(MechanicalReference, Hopper) {
  Problem("P11", LegHopper(), [](const auto* p) {
    using T = std::remove_cvref_t<decltype(*p)>;
    using std::cos, std::sin;
    return std::array<T, 8>{-p[3] * sin(p[10]) - p[4] * sin(p[11]),
                            p[3] * cos(p[10]) + p[4] * cos(p[11]),
                            p[10],
                            p[11],
                            T(0.0),
                            T(0.0),
                            T(0.0),
                            T(0.0)};
  }).ExpectReference();
}

// ---------------------------------------------------------------------------------------------------------------------
// Stored outputs of the event-driven integrator of Siconos, to their accuracy.

// A ball of mass 1 between a floor and a ceiling.
struct BallBetweenPlates {
  static constexpr int kNumCoordinates = 1, kNumControls = 0, kNumParameters = 3, kNumContacts = 2;
  static constexpr std::array<const char*, 3> kParameterNames = {"g", "e", "ceiling"};

  template <typename T>
  void Mass(const T*, const T*, T* M) const {
    M[0] = T(1.0);
  }
  template <typename T>
  void Force(const T&, const T*, const T*, const T*, const T* p, T* h) const {
    h[0] = -p[0];
  }
  template <typename T>
  T Gap(int contact, const T* q, const T* p) const {
    return contact == 0 ? q[0] : T(p[2] - q[0]);
  }
  template <typename T>
  T Restitution(int, const T* p) const {
    return p[1];
  }
};

// A point mass on a taut string of length 1, y downwards: a contact that lasts, whose gap is no distance.
struct TautString {
  static constexpr int kNumCoordinates = 2, kNumControls = 0, kNumParameters = 1, kNumContacts = 1;
  static constexpr std::array<const char*, 1> kParameterNames = {"g"};

  template <typename T>
  void Mass(const T*, const T*, T* M) const {
    M[0] = M[3] = T(1.0);
    M[1] = M[2] = T(0.0);
  }
  template <typename T>
  void Force(const T&, const T*, const T*, const T*, const T* p, T* h) const {
    h[0] = T(0.0);
    h[1] = p[0];
  }
  template <typename T>
  T Gap(int, const T* q, const T*) const {
    return 1.0 - q[0] * q[0] - q[1] * q[1];
  }
  template <typename T>
  T Restitution(int, const T*) const {
    return T(0.0);
  }
};

// A block without friction whose contacts are the points (-a, -b) and (a, -b) of it.
struct BlockOnCorners {
  static constexpr int kNumCoordinates = 3, kNumControls = 0, kNumParameters = 5, kNumContacts = 2;
  static constexpr std::array<const char*, 5> kParameterNames = {"J", "a", "b", "g", "e"};

  template <typename T>
  void Mass(const T*, const T* p, T* M) const {
    for (int i = 0; i < 9; ++i) M[i] = T(0.0);
    M[0] = M[4] = T(1.0);
    M[8] = p[0];
  }
  template <typename T>
  void Force(const T&, const T*, const T*, const T*, const T* p, T* h) const {
    h[0] = h[2] = T(0.0);
    h[1] = -p[3];
  }
  template <typename T>
  T Gap(int contact, const T* q, const T* p) const {
    using std::cos, std::sin;
    return q[1] + (contact == 0 ? -1.0 : 1.0) * p[1] * sin(q[2]) - p[2] * cos(q[2]);
  }
  template <typename T>
  T Restitution(int, const T* p) const {
    return p[4];
  }
};

const json& Siconos(const std::string& example) { return ReferenceFile("siconos_event_driven.json").at(example); }

// Simulates an example on as many intervals as it has rows, and compares these.
HybridSimulator SimulateExample(const MechanicalSystem& system, const json& example, const std::vector<double>& initial,
                                const std::vector<double>& parameters, double tolerance) {
  HybridInput input{.initial = initial, .parameters = parameters, .duration = example.at("T")};
  const json rows = example.value("rows", json::array());
  input.num_intervals = std::max<int>(1, static_cast<int>(rows.size()));
  const MechanicalSystem::Start start = system.FindMode(initial, {}, parameters);
  EXPECT_GE(start.mode, 0) << start.reason;
  input.mode = start.mode;
  HybridSimulator simulator(system.hybrid(), {.tolerance = 1e-14});
  EXPECT_TRUE(simulator.Rollout(input)) << simulator.FailureReason();
  for (int k = 0; k < static_cast<int>(rows.size()); ++k) {
    for (int i = 0; i < static_cast<int>(rows[k].size()); ++i) {
      EXPECT_NEAR(simulator.StateAt(k + 1)[i], rows[k][i].get<double>(), tolerance) << "row " << k << ", number " << i;
    }
  }
  return simulator;
}

TEST(Siconos, BouncingBall) {
  const MechanicalSystem system{BallBetweenPlates()};
  const json& example = Siconos("ball");
  const HybridSimulator simulator = SimulateExample(system, example, {1, 0}, {9.81, 0.9, 10}, 1e-10);
  ASSERT_EQ(simulator.events().size(), 44u);
  for (int i = 0; i < 44; ++i) {
    EXPECT_NEAR(simulator.events()[i].time, example["impacts"][i][0].get<double>(), 1e-11) << i;
    EXPECT_NEAR(simulator.events()[i].after[1], example["impacts"][i][1].get<double>(), 1e-10) << i;
  }
  // The exact values, of which the stored ones miss the tenth digit.
  EXPECT_NEAR(simulator.final_state()[0], 5.565551008992671e-06, 1e-13);
  EXPECT_NEAR(simulator.final_state()[1], -0.041665195809813558, 1e-12);
}

// Bounces accumulate on the floor at 6.2072.
TEST(Siconos, BallBetweenTwoPlates) {
  const MechanicalSystem system{BallBetweenPlates()};
  const json& example = Siconos("two_contacts");
  const HybridSimulator simulator = SimulateExample(system, example, {1, 10}, {10, 0.8, 1.5}, 1e-7);
  for (int i = 0; i < static_cast<int>(example["impacts"].size()); ++i) {
    EXPECT_NEAR(simulator.events()[i].time, example["impacts"][i][0].get<double>(), 1e-11) << i;
    EXPECT_NEAR(simulator.events()[i].after[1], example["impacts"][i][1].get<double>(), 1e-10) << i;
  }
  HybridInput input{.initial = {1, 10}, .parameters = {10, 0.8, 1.5}, .duration = 10};
  const MechanicalReport report = system.Examine(simulator, input);
  ASSERT_EQ(report.accumulations.size(), 1u);
  EXPECT_NEAR(report.impacts[report.accumulations[0]].accumulates_at, 6.2072372420863110777, 1e-10);
  EXPECT_EQ(simulator.final_state()[0], 0);
  EXPECT_EQ(simulator.final_state()[1], 0);
}

TEST(Siconos, PendulumOnATautString) {
  const MechanicalSystem system{TautString()};
  const double angle = std::numbers::pi / 3;
  const HybridSimulator simulator =
      SimulateExample(system, Siconos("pendulum"), {std::sin(angle), std::cos(angle), 0, 0}, {9.81}, 5e-11);
  const double exact[] = {-0.60666849592177808, 0.79495492705939469, 1.9123608074244532, 1.4594148865666048};
  for (int i = 0; i < 4; ++i) EXPECT_NEAR(simulator.final_state()[i], exact[i], 1e-11) << i;
}

TEST(Siconos, BlockOnACorner) {
  const MechanicalSystem system{BlockOnCorners()};
  const json& example = Siconos("block");
  const double angle = std::numbers::pi / 3, height = 0.5 * std::sin(angle) + 0.25 * std::cos(angle);
  SimulateExample(system,
                  example,
                  {0.25 - 0.25 * std::sin(angle), height, angle, 0, 0, 0},
                  {5.0 / 48, 0.5, 0.25, 9.81, 0.8},
                  2e-12);
}

// The stored impacts are resolved by a compliant law, so they have the error of its steps; the exact ones are beside.
TEST(Siconos, BlockThatFalls) {
  constexpr double kExact[7][2] = {{0.301680702028328097, -0.342425178898207011},
                                   {0.785010956691233713, -1.35888153844638954},
                                   {1.17872590477343967, -3.74935703306414183},
                                   {1.41750974015758361, -2.42653484048266828},
                                   {1.64973312395241579, -2.43672380927177345},
                                   {1.83572272856110105, -3.1495396423864641},
                                   {1.98899391771037268, -4.15104585305978797}};
  const MechanicalSystem system{BlockOnCorners()};
  const json& example = Siconos("block_that_falls");
  const HybridSimulator simulator = SimulateExample(
      system, example, {0, 0.55801270189221930, std::numbers::pi / 3, 0, 0, 0}, {5.0 / 48, 0.1, 0.05, 9.81, 0.8}, 0);
  ASSERT_EQ(simulator.events().size(), 7u);
  for (int i = 0; i < 7; ++i) {
    EXPECT_NEAR(simulator.events()[i].time, kExact[i][0], 1e-11) << i;
    EXPECT_NEAR(simulator.events()[i].after[5], kExact[i][1], 1e-9) << i;
    EXPECT_NEAR(simulator.events()[i].time, example["impacts"][i][0].get<double>(), 1e-4) << i;
    EXPECT_NEAR(simulator.events()[i].after[5], example["impacts"][i][1].get<double>(), 2e-3) << i;
  }
}

}  // namespace
}  // namespace saltus
