#include "base/statistics.h"

#include <gtest/gtest.h>

#include <limits>
#include <vector>

namespace saltus {
namespace {

TEST(StatisticsTest, NumbersAreFiniteUnlessOneOfThemIsInfiniteOrNotANumber) {
  using Limits = std::numeric_limits<double>;
  const std::vector<double> finite = {0.0, -0.0, 1.0, -1.5, Limits::max(), Limits::lowest(), Limits::denorm_min()};
  EXPECT_TRUE(AllFinite({}));
  EXPECT_TRUE(AllFinite(finite));
  for (const double other : {Limits::infinity(), -Limits::infinity(), Limits::quiet_NaN(), -Limits::quiet_NaN()}) {
    for (std::size_t i = 0; i < finite.size(); ++i) {
      std::vector<double> numbers = finite;
      numbers[i] = other;
      EXPECT_FALSE(AllFinite(numbers)) << other << " at " << i;
    }
  }
}

TEST(StatisticsTest, TheLargestMagnitudeIsFoundWhereverItIs) {
  EXPECT_EQ(Largest({}), 0);
  for (std::size_t size = 1; size < 12; ++size) {
    for (std::size_t i = 0; i < size; ++i) {
      std::vector<double> numbers(size, 0.5);
      numbers[i] = -3;
      EXPECT_EQ(Largest(numbers), 3) << i << " of " << size;
    }
  }
}

}  // namespace
}  // namespace saltus
