// The costs of a rollout with its loss (forward) and of the loss with its whole gradient, and how they grow.
//
//   Gradient   per contact model, on two balls with 480 steps and 960 controls; beside it code written by hand for this
//              one scene and model, a lower bound
//   Steps      the same per step, from 480 to 480 000 steps
//   Growth     that at 480 000 steps relative to the others, in turns, so that what the machine does meanwhile cancels
//   Certificate of motions with 700 and 7000 impacts: the latter's time relative to ten times the former's
//   Bodies     per body and step: a gas in a box at fixed density, 10 to 1000 discs
//   Batch      losses and gradients of 4096 motions one by one and in a batch, in turns on one thread
//   Throughput gradients per second of a batch, by number of threads (wall clock)
#include <benchmark/benchmark.h>

#include <cmath>
#include <memory>

#include "base/random.h"
#include "saltus/control/batch.h"
#include "saltus/optimality/certificate.h"
#include "saltus/scene/scene.h"
#include "saltus/simulate/registry.h"
#include "scene/scene_generators.h"
#include "timing.h"

namespace saltus {
namespace {

struct Costs {
  double forward;   // s
  double gradient;  // s, the forward pass included
};

Costs MeasureCosts(const std::string& contact, const Scene& scene) {
  SingleShooting shooting(MakeSimulator(contact, scene, Precision::kDouble));
  std::vector<double> z = shooting.initial_guess(), gradient(z.size());
  double loss = 0;
  CHECK(shooting.Evaluate(z, &loss, gradient.data())) << contact;
  const auto [forward, with_gradient] =
      TimeInTurns([&] { benchmark::DoNotOptimize(shooting.Evaluate(z, &loss, nullptr)); },
                  [&] { benchmark::DoNotOptimize(shooting.Evaluate(z, &loss, gradient.data())); });
  return {forward, with_gradient};
}

// Two balls and direct_toi written out: the sums of single_shooting.h without anything general.
class HandWritten {
 public:
  explicit HandWritten(const Scene& scene) : scene_(scene), u_(2 * scene.steps), gradient_(u_.size()) {
    for (int k = 0; k < scene.steps; ++k) {
      for (int j = 0; j < 2; ++j) u_[2 * k + j] = scene.control.initial[0][j];
    }
  }

  double Forward() {
    const double h = scene_.dt(), radius = scene_.bodies[0].radius + scene_.bodies[1].radius;
    Vec2d p = scene_.bodies[0].position, q = scene_.bodies[1].position;
    Vec2d v = Vec2d::Zero(), w = Vec2d::Zero();
    double effort = 0;
    contact_ = -1;
    for (int k = 0; k < scene_.steps; ++k) {
      const Vec2d u(u_[2 * k], u_[2 * k + 1]);
      effort += u[0] * u[0] + u[1] * u[1];
      const Vec2d d = (p + h * v) - (q + h * w);
      const double squared = Dot(d, d);
      Vec2d impulse = Vec2d::Zero();
      double lever = h;
      if (squared < radius * radius) {
        const double distance = std::sqrt(squared);
        const Vec2d n = d / distance;
        const double s = Dot(n, Vec2d(v - w));
        if (s < 0) {
          contact_ = k;
          d_ = d;
          relative_ = v - w;
          impulse = -s * n;
          lever += std::min((distance - radius) / std::min(-1e-3, s) - h, 0.0);
        }
      }
      v += h * u;
      p += h * v + lever * impulse;
      q += h * w - lever * impulse;
      v += impulse;
      w -= impulse;
    }
    end_ = q;
    return Dot(q, q) + scene_.objective.effort * effort * h;
  }

  double Gradient() {
    const double loss = Forward();
    const double h = scene_.dt(), radius = scene_.bodies[0].radius + scene_.bodies[1].radius;
    Vec2d p = Vec2d::Zero(), v = Vec2d::Zero(), q = 2 * end_, w = Vec2d::Zero();  // cotangents
    const double factor = 2 * scene_.objective.effort * h;
    for (int k = scene_.steps - 1; k >= 0; --k) {
      Vec2d to_d = Vec2d::Zero(), to_relative = Vec2d::Zero();
      if (k == contact_) {
        const double distance = std::sqrt(Dot(d_, d_));
        const Vec2d n = d_ / distance;
        const double s = Dot(n, relative_);
        const double lever = std::min((distance - radius) / s, h);
        // impulse = -s n; p += lever impulse, v += impulse; q, w likewise with the opposite sign.
        const Vec2d to_impulse = lever * (p - q) + (v - w);
        const double to_lever = Dot(Vec2d(p - q), Vec2d(-s * n));
        double to_s = -Dot(to_impulse, n), to_distance = 0;
        if ((distance - radius) / s < h) {
          to_distance = to_lever / s;
          to_s -= to_lever * (distance - radius) / (s * s);
        }
        const Vec2d to_n = -s * to_impulse + to_s * relative_;
        to_d = (to_n - Dot(n, to_n) * n) / distance + to_distance * n;
        to_relative = to_s * n;
      }
      const Vec2d sum = v + h * p;
      gradient_[2 * k] = h * sum[0] + factor * u_[2 * k];
      gradient_[2 * k + 1] = h * sum[1] + factor * u_[2 * k + 1];
      v = sum + h * to_d + to_relative;
      w += h * q - h * to_d - to_relative;
      p += to_d;
      q -= to_d;
    }
    return loss;
  }

  const std::vector<double>& gradient() const { return gradient_; }

 private:
  Scene scene_;
  std::vector<double> u_, gradient_;
  int contact_ = -1;
  Vec2d d_, relative_, end_;
};

void Gradient(benchmark::State& state, const std::string& contact) {
  const Scene scene = ProblemScene("two_balls", 480);
  if (const std::string why = ReasonNotApplicable(contact, scene); !why.empty())
    return state.SkipWithError(why.c_str());
  for (auto _ : state) {
    const Costs costs = MeasureCosts(contact, scene);
    state.SetIterationTime(costs.gradient);
    state.counters["forward_us"] = 1e6 * costs.forward;
    state.counters["gradient_us"] = 1e6 * costs.gradient;
    state.counters["gradient_by_forward"] = costs.gradient / costs.forward;
  }
}

void GradientByHand(benchmark::State& state) {
  const Scene scene = ProblemScene("two_balls", 480);
  HandWritten by_hand(scene);
  // It must do the same work.
  SingleShooting shooting(MakeSimulator("direct_toi", scene, Precision::kDouble));
  std::vector<double> gradient(shooting.num_variables());
  double loss = 0;
  CHECK(shooting.Evaluate(shooting.initial_guess(), &loss, gradient.data()));
  CHECK_NEAR(by_hand.Gradient(), loss, 1e-12);
  for (size_t i = 0; i < gradient.size(); ++i) CHECK_NEAR(by_hand.gradient()[i], gradient[i], 1e-12);
  for (auto _ : state) {
    const auto [forward, with_gradient] = TimeInTurns([&] { benchmark::DoNotOptimize(by_hand.Forward()); },
                                                      [&] { benchmark::DoNotOptimize(by_hand.Gradient()); });
    state.SetIterationTime(with_gradient);
    state.counters["forward_us"] = 1e6 * forward;
    state.counters["gradient_us"] = 1e6 * with_gradient;
    state.counters["gradient_by_forward"] = with_gradient / forward;
  }
}

void PerUnit(benchmark::State& state, const std::string& contact, const Scene& scene, double units) {
  for (auto _ : state) {
    const Costs costs = MeasureCosts(contact, scene);
    state.SetIterationTime(costs.gradient);
    state.counters["forward_ns"] = 1e9 * costs.forward / units;
    state.counters["gradient_ns"] = 1e9 * costs.gradient / units;
  }
}

void Steps(benchmark::State& state, const std::string& contact) {
  const int steps = static_cast<int>(state.range(0));
  PerUnit(state, contact, ProblemScene("two_balls", steps), steps);
}

void Growth(benchmark::State& state, const std::string& contact) {
  const auto run_of = [&](int steps) {
    auto shooting =
        std::make_shared<SingleShooting>(MakeSimulator(contact, ProblemScene("two_balls", steps), Precision::kDouble));
    return [shooting, gradient = std::vector<double>(shooting->num_variables())](bool with_gradient) mutable {
      double loss = 0;
      CHECK(shooting->Evaluate(shooting->initial_guess(), &loss, with_gradient ? gradient.data() : nullptr));
    };
  };
  auto a = run_of(480), b = run_of(4800), c = run_of(48'000), d = run_of(480'000);
  for (auto _ : state) {
    for (const bool with_gradient : {false, true}) {
      const auto [few, more, many, most] = TimeInTurns(
          [&] { a(with_gradient); }, [&] { b(with_gradient); }, [&] { c(with_gradient); }, [&] { d(with_gradient); });
      const std::string of = with_gradient ? "gradient" : "forward";
      state.counters[of + "_by_480"] = most / few / 1000;
      state.counters[of + "_by_4800"] = most / more / 100;
      state.counters[of + "_by_48000"] = most / many / 10;
      state.SetIterationTime(most);
    }
  }
}

// The motion of two balls of which one is pushed against the other again and again.
void CertificateOfManyImpacts(benchmark::State& state) {
  const auto run_of = [](double duration) {
    Scene scene = ProblemScene("two_balls", 480);
    scene.duration = duration;
    return [scene, initial = InitialState(scene), control = InitialControl(scene, scene.steps)] {
      benchmark::DoNotOptimize(Certify(scene, initial, control));
    };
  };
  for (auto _ : state) {
    const auto [few, many] = TimeInTurns(run_of(1e3), run_of(1e4));
    state.counters["growth"] = many / few / 10;
    state.SetIterationTime(many);
  }
}

void Bodies(benchmark::State& state, const std::string& contact) {
  Scene scene = GasInABox({.discs = static_cast<int>(state.range(0))}, 1);
  scene.contact.stiffness = 1e5;
  PerUnit(state, contact, scene, double(scene.num_bodies()) * scene.steps);
}

// Points around the initial guess, in which most strikers meet the target, each at a time of its own.
std::vector<double> RandomPoints(const std::vector<double>& guess, int count) {
  std::vector<double> points;
  NormalStream normals(1);
  for (int i = 0; i < count; ++i) {
    const double push = 0.3 * normals.Next(), turn = 0.03 * normals.Next();
    for (size_t j = 0; j < guess.size(); ++j) {
      points.push_back(guess[j] + push + (j % 2 == 0 ? turn : -turn) + 0.1 * normals.Next());
    }
  }
  return points;
}

void BatchOfMotions(benchmark::State& state, const std::string& contact) {
  const Scene scene = ProblemScene("two_balls", 480);
  if (const std::string why = ReasonNotApplicable(contact, scene); !why.empty())
    return state.SkipWithError(why.c_str());
  SingleShooting shooting(MakeSimulator(contact, scene, Precision::kDouble));
  Batch batch(contact, scene, Precision::kDouble, 1);
  constexpr int kMotions = 4096;
  const size_t size = shooting.num_variables();
  const std::vector<double> points = RandomPoints(batch.initial_guess(), kMotions);
  std::vector<double> losses(kMotions), gradients(points.size());
  const auto one_by_one = [&](bool with_gradient) {
    for (int i = 0; i < kMotions; ++i) {
      shooting.Evaluate({&points[i * size], size}, &losses[i], with_gradient ? &gradients[i * size] : nullptr);
    }
  };
  for (auto _ : state) {
    const auto [losses_alone, losses_together, alone, together] =
        TimeInTurns([&] { one_by_one(false); },
                    [&] { batch.Evaluate(points, losses); },
                    [&] { one_by_one(true); },
                    [&] { batch.Evaluate(points, losses, gradients); });
    state.SetIterationTime(together);
    state.counters["loss_us"] = 1e6 * losses_together / kMotions;
    state.counters["gradient_us"] = 1e6 * together / kMotions;
    state.counters["loss_gain"] = losses_alone / losses_together;
    state.counters["gradient_gain"] = alone / together;
  }
}

void Throughput(benchmark::State& state, const std::string& contact) {
  const Scene scene = ProblemScene("two_balls", 480);
  Batch batch(contact, scene, Precision::kDouble, static_cast<int>(state.range(0)));
  constexpr int kPoints = 2000;
  std::vector<double> points, losses(kPoints);
  for (int i = 0; i < kPoints; ++i)
    points.insert(points.end(), batch.initial_guess().begin(), batch.initial_guess().end());
  std::vector<double> gradients(points.size());
  for (auto _ : state) batch.Evaluate(points, losses, gradients);
  state.counters["gradients_per_second"] =
      benchmark::Counter(double(kPoints) * state.iterations(), benchmark::Counter::kIsRate);
}

void RegisterAll() {
  // Every benchmark repeats and takes the least by itself.
  const auto once = [](benchmark::internal::Benchmark* benchmark) {
    return benchmark->UseManualTime()->Iterations(1)->Unit(benchmark::kMicrosecond);
  };
  once(benchmark::RegisterBenchmark("Gradient/by_hand", GradientByHand));
  for (const ModelTraits& model : AllContactModels()) {
    const std::string name(model.name);
    once(benchmark::RegisterBenchmark(("Gradient/" + name).c_str(), Gradient, name));
    once(benchmark::RegisterBenchmark(("Batch/" + name).c_str(), BatchOfMotions, name));
  }
  once(benchmark::RegisterBenchmark("Certificate/impacts", CertificateOfManyImpacts));
  for (const std::string name : {"direct_toi", "compliant_warp", "event"}) {
    auto* steps = once(benchmark::RegisterBenchmark(("Steps/" + name).c_str(), Steps, name));
    for (int n : {480, 4800, 48000, 480000}) steps->Arg(n);
    once(benchmark::RegisterBenchmark(("Growth/" + name).c_str(), Growth, name));
    auto* bodies = once(benchmark::RegisterBenchmark(("Bodies/" + name).c_str(), Bodies, name));
    for (int n : {10, 30, 100, 300, 1000}) bodies->Arg(n);
    benchmark::RegisterBenchmark(("Throughput/" + name).c_str(), Throughput, name)
        ->Arg(1)
        ->Arg(2)
        ->UseRealTime()
        ->Unit(benchmark::kMillisecond);
  }
}

}  // namespace
}  // namespace saltus

int main(int argc, char** argv) {
  saltus::RegisterAll();
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 2;
  benchmark::RunSpecifiedBenchmarks();
  benchmark::Shutdown();
}
