// Derivatives of a tape against those of Jets.
#include "saltus/internal/taped.h"

#include <gtest/gtest.h>

#include "saltus/scene/geometry.h"

namespace saltus {
namespace {

// Every operation that there is, on six variables.
template <typename T>
T Expression(const T* x) {
  const Vec2<T> d = Vec2<T>(x[0], x[1]) - Vec2<T>(x[2], x[3]);
  const Separation<T> at = Separate<T>(d, Vec2<T>(x[4], T(0.3)));
  T sum = Dot(at.normal, d) - 2.0 * at.distance + Divide(x[5], at.distance) * 0.5;
  sum += Divide(1.5, x[5]) - Divide(x[4], 3.0);
  sum -= 0.25 - x[1];
  sum *= x[0] + 1.0;
  return -sum + SafeSqrt(T(x[2] * x[2])) * Value(x[3]) + SafeSqrt(T(x[2] - x[2]));
}

TEST(Taped, HasTheValuesAndDerivativesOfJets) {
  const double at[6] = {1.3, -0.4, 0.7, 2.1, -0.9, 1.7};
  StepJet<double> jets[6];
  Taped taped[6];
  Tape& tape = Tape::ThreadTape();
  tape.Clear();
  for (int i = 0; i < 6; ++i) {
    jets[i] = StepJet<double>(at[i], i);
    taped[i] = Taped::Variable(at[i]);
  }
  const StepJet<double> expected = Expression(jets);
  const Taped found = Expression(taped);
  EXPECT_EQ(found.value(), expected.a);
  const std::pair<int, double> cotangent{found.place(), 1.0};
  const std::span<const double> derivatives = tape.Sweep({&cotangent, 1});
  for (int i = 0; i < 6; ++i) EXPECT_NEAR(derivatives[taped[i].place()], expected.v[i], 1e-13) << i;
}

TEST(Taped, AMapIsSweptOnce) {
  Tape& tape = Tape::ThreadTape();
  tape.Clear();
  const std::vector<Taped> in = {Taped::Variable(2), Taped(5.0), Taped::Variable(3)};
  // y = (2 a + b, c - a), between operations on both sides.
  const std::vector<Taped> squares = {in[0] * in[0], in[1], in[2]};
  std::vector<Taped> out = {Taped(2 * 4.0 + 5), Taped(3 - 4.0)};
  int sweeps = 0;
  tape.AddMap(squares, out, [&](std::span<const double> after, std::span<double> before) {
    ++sweeps;
    before[0] = 2 * after[0] - after[1];
    before[1] = after[0];
    before[2] = after[1];
  });
  const Taped result = out[0] * out[1];
  EXPECT_EQ(result.value(), -13);
  const std::pair<int, double> cotangent{result.place(), 1.0};
  const std::span<const double> derivatives = tape.Sweep({&cotangent, 1});
  EXPECT_EQ(sweeps, 1);
  // d/da of (2 a^2 + 5) (c - a^2), and d/dc
  EXPECT_EQ(derivatives[in[0].place()], 4 * 2 * -1 + 13 * -2 * 2);
  EXPECT_EQ(derivatives[in[2].place()], 13);
}

}  // namespace
}  // namespace saltus
