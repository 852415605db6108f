#include "global/interval.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cfenv>
#include <cmath>
#include <vector>

#include "base/random.h"
#include "global/taylor_model.h"

namespace saltus::global {
namespace {

// The sum, product, quotient and root of two numbers, in more digits.
TEST(Interval, IsRoundedOutward) {
  Random random(3);
  std::vector<double> numbers;
  for (int i = 0; i < 2000; ++i) numbers.push_back(random.Symmetric());
  int wide = 0;
  for (size_t i = 0; i + 1 < numbers.size(); i += 2) {
    const long double a = numbers[i], b = numbers[i + 1];
    std::vector<std::pair<Interval, long double>> cases;
    {
      const RoundUpward rounding;
      const Interval x(numbers[i]), y(numbers[i + 1]);
      cases = {{x + y, 0}, {x - y, 0}, {x * y, 0}, {x / y, 0}, {Square(x), 0}, {Reciprocal(y), 0}};
    }
    const long double exact[] = {a + b, a - b, a * b, a / b, a * a, 1 / b};
    for (size_t k = 0; k < cases.size(); ++k) {
      EXPECT_LE(cases[k].first.lower(), exact[k]);
      EXPECT_GE(cases[k].first.upper(), exact[k]);
      EXPECT_LE(cases[k].first.upper() - cases[k].first.lower(), 5e-16 * std::abs(static_cast<double>(exact[k])));
      wide += cases[k].first.lower() < cases[k].first.upper();
    }
  }
  EXPECT_GT(wide, 3000);
}

TEST(Interval, RestoresTheRounding) {
  ASSERT_EQ(std::fegetround(), FE_TONEAREST);
  {
    const RoundUpward rounding;
    EXPECT_EQ(std::fegetround(), FE_UPWARD);
  }
  EXPECT_EQ(std::fegetround(), FE_TONEAREST);
}

// A function of three parameters with all operations of models.
template <typename T, typename Constant>
T Sample(const T& x, const T& y, const T& z, const Constant& tenth) {
  const T inverse = Reciprocal(T(Constant(1.0)) + Square(y));
  T f = x * Square(y - tenth * z) + inverse * x;
  f -= tenth * (x * (y * z));
  f += Square(x * z - inverse);
  return f;
}

// The parameters of a sample, their ranges, and its model there.
struct SampleModel {
  explicit SampleModel(Random* random) : width(std::pow(10, -8 * random->Unit())) {
    for (int j = 0; j < 3; ++j) {
      low[j] = random->Symmetric();
      high[j] = low[j] + 0.5 * width * random->Unit();
    }
    const RoundUpward rounding;
    Compute();
  }
  [[gnu::noinline]] void Compute() {
    TaylorModel<3> at[3];
    for (int j = 0; j < 3; ++j) at[j] = TaylorModel<3>::Parameter(j, low[j], high[j]);
    for (int j = 0; j < 3; ++j) range[j] = at[j];
    model = Sample(at[0], at[1], at[2], Interval(1.0) / Interval(10.0));
  }
  // The function at a point that is given by where it is in each range, from -1 to 1.
  long double At(const std::array<long double, 3>& x) const {
    long double at[3];
    for (int j = 0; j < 3; ++j) at[j] = range[j].value + range[j].slope[j] * x[j];
    return Sample(at[0], at[1], at[2], 1.0L / 10);
  }
  long double Polynomial(const std::array<long double, 3>& x) const {
    long double sum = model.value;
    for (int j = 0, at = 0; j < 3; ++j) {
      sum += model.slope[j] * x[j];
      for (int k = j; k < 3; ++k, ++at) sum += model.curve[at] * x[j] * x[k];
    }
    return sum;
  }

  double width;
  std::array<double, 3> low, high;
  TaylorModel<3> range[3], model;
};

TEST(TaylorModel, EnclosesTheFunctionInTheBox) {
  Random random(5);
  for (int i = 0; i < 300; ++i) {
    const SampleModel sample(&random);
    EXPECT_LE(sample.model.error, 20 * std::pow(sample.width, 3) + 1e-13);
    for (int k = 0; k < 30; ++k) {
      std::array<long double, 3> x;
      for (long double& part : x) part = k < 8 ? (random.UniformIndex(2) == 0 ? -1 : 1) : random.Symmetric();
      EXPECT_LE(std::abs(sample.At(x) - sample.Polynomial(x)), sample.model.error) << sample.width;
    }
  }
}

TEST(TaylorModel, IsBoundedInPartsOfTheBox) {
  Random random(6);
  for (int i = 0; i < 300; ++i) {
    const SampleModel sample(&random);
    BoxPart<3> part;
    for (int j = 0; j < 3; ++j) {
      part.low[j] = random.Symmetric();
      part.high[j] = std::min(1.0, part.low[j] + random.Unit());
    }
    {
      const RoundUpward rounding;
      BoundPart(sample.model, {}, &part);
    }
    long double least = INFINITY;
    for (int k = 0; k < 200; ++k) {
      std::array<long double, 3> x;
      for (int j = 0; j < 3; ++j) {
        const double at = k < 50 ? random.UniformIndex(2) : random.Unit();
        x[j] = part.low[j] + at * (part.high[j] - part.low[j]);
      }
      least = std::min(least, sample.At(x));
    }
    EXPECT_LE(part.least, least);
    EXPECT_GE(part.least, least - 20 * std::pow(sample.width, 2) - 1e-12);
  }
}

// (x - 1/4)^2 is least inside, and x (3 - x) at an end.
TEST(TaylorModel, HasItsLeastInsideOrAtAnEnd) {
  BoxPart<1> whole{{-1}, {1}}, half{{0}, {1}};
  double inside, at_low;
  {
    const RoundUpward rounding;
    const auto x = TaylorModel<1>::Parameter(0, -1, 1);
    BoundPart(Square(x - TaylorModel<1>(Interval(0.25))), {}, &whole);
    BoundPart(x * (TaylorModel<1>(Interval(3.0)) - x), {}, &half);
    inside = whole.least;
    at_low = half.least;
  }
  EXPECT_NEAR(inside, 0, 1e-12);
  EXPECT_LE(inside, 0);
  EXPECT_NEAR(at_low, 0, 1e-12);
  EXPECT_LE(at_low, 0);
}

// 1 + 5 (y - x) is -6.5 at x = 1 and y = -0.5, but at least 1 where y comes after x.
TEST(TaylorModel, WaitsAreNotNegative) {
  BoxPart<2> with{{-1, -1}, {1, 1}}, without = with;
  {
    const RoundUpward rounding;
    const auto x = TaylorModel<2>::Parameter(0, 0, 1), y = TaylorModel<2>::Parameter(1, -0.5, 0.5);
    const TaylorModel<2> f = TaylorModel<2>(Interval(1.0)) + Interval(5.0) * (y - x);
    BoundPart(f, {{0, 1, y - x}}, &with);
    BoundPart(f, {}, &without);
  }
  EXPECT_NEAR(with.least, 1, 1e-12);
  EXPECT_LE(with.least, 1);
  EXPECT_NEAR(without.least, -6.5, 1e-12);
}

TEST(TaylorModel, IncludesTheRoundingOfProducts) {
  Random random(8);
  for (int i = 0; i < 100; ++i) {
    const double a = random.Symmetric(), b = random.Symmetric();
    TaylorModel<1> product;
    {
      const RoundUpward rounding;
      product = TaylorModel<1>(Interval(a)) * TaylorModel<1>(Interval(b));
    }
    EXPECT_LE(std::abs(product.value - static_cast<long double>(a) * b), product.error);
  }
}

// 1 / (2 + x) is 1 at the lower end, where the polynomial (1 - x / 2 + x^2 / 4) / 2 is 7/8.
TEST(TaylorModel, ReciprocalHasARemainder) {
  const RoundUpward rounding;
  const TaylorModel<1> inverse = Reciprocal(TaylorModel<1>::Parameter(0, 1, 3));
  EXPECT_GE(inverse.error, 0.125);
  EXPECT_LE(inverse.error, 0.126);
}

TEST(TaylorModel, HasNoReciprocalAroundZero) {
  const RoundUpward rounding;
  EXPECT_EQ(Reciprocal(TaylorModel<1>::Parameter(0, -1, 2)).error, INFINITY);
}

}  // namespace
}  // namespace saltus::global
