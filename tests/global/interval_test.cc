#include "global/interval.h"

#include <gtest/gtest.h>

#include <cfenv>
#include <vector>

#include "base/random.h"

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

TEST(Jet, HasTheDerivatives) {
  using S = Jet<double, 2>;
  S x(0.7), y(-1.3);
  x.slope[0] = y.slope[1] = 1;
  const S f = Square(x) * y - Reciprocal(y) * 2.0 + x;
  EXPECT_DOUBLE_EQ(f.value, 0.7 * 0.7 * -1.3 + 2 / 1.3 + 0.7);
  EXPECT_DOUBLE_EQ(f.slope[0], 2 * 0.7 * -1.3 + 1);
  EXPECT_DOUBLE_EQ(f.slope[1], 0.7 * 0.7 + 2 / (1.3 * 1.3));
}

}  // namespace
}  // namespace saltus::global
