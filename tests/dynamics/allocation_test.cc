// Neither a rollout nor its gradient asks for memory once it has been evaluated before.
#include <gtest/gtest.h>

#include <atomic>
#include <cstdlib>
#include <new>

#include "physics/scene_generators.h"
#include "saltus/control/single_shooting.h"
#include "saltus/dynamics/registry.h"
#include "test_scenes.h"

namespace {

std::atomic<long> allocations = 0;

void* Allocate(std::size_t size, std::size_t alignment) {
  ++allocations;
  void* memory = alignment <= alignof(std::max_align_t)
                     ? std::malloc(size)
                     : std::aligned_alloc(alignment, (size + alignment - 1) / alignment * alignment);
  if (memory == nullptr) throw std::bad_alloc();
  return memory;
}

}  // namespace

// Not inlined: GCC would take std::free for the wrong partner of operator new.
[[gnu::noinline]] void* operator new(std::size_t size) { return Allocate(size, 1); }
void* operator new(std::size_t size, std::align_val_t alignment) {
  return Allocate(size, static_cast<std::size_t>(alignment));
}
[[gnu::noinline]] void operator delete(void* memory) noexcept { std::free(memory); }
[[gnu::noinline]] void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }
[[gnu::noinline]] void operator delete(void* memory, std::align_val_t) noexcept { std::free(memory); }
[[gnu::noinline]] void operator delete(void* memory, std::size_t, std::align_val_t) noexcept { std::free(memory); }

namespace saltus {
namespace {

TEST(Allocation, IsCounted) {
  const long before = allocations;
  std::vector<double> some(100);
  EXPECT_GT(allocations, before) << some[0];
}

class AllocationOf : public testing::TestWithParam<std::string> {
 protected:
  // Evaluates twice to settle, then counts.
  void ExpectNone(const Scene& scene, Precision precision) {
    if (!WhyNotApplicable(GetParam(), scene).empty()) return;
    SingleShooting shooting(MakeSimulator(GetParam(), scene, precision));
    std::vector<double> z = shooting.initial_guess(), gradient(z.size());
    double loss = 0;
    for (int i = 0; i < 2; ++i) ASSERT_TRUE(shooting.Evaluate(z, &loss, gradient.data()));
    EXPECT_FALSE(shooting.simulator().touches().empty());
    const long before = allocations;
    for (int i = 0; i < 3; ++i) ASSERT_TRUE(shooting.Evaluate(z, &loss, gradient.data()));
    EXPECT_EQ(allocations - before, 0) << scene.name;
  }
};

TEST_P(AllocationOf, RolloutAndGradient) {
  for (Precision precision : {Precision::kDouble, Precision::kFloat}) {
    for (const char* name : {"two_balls", "ground_wall"}) ExpectNone(ProblemScene(name), precision);
    ExpectNone(FourDiscs(0), precision);
    ExpectNone(FourDiscs(0.3), precision);
    ExpectNone(GasInABox({.discs = 60}, 1), precision);
  }
}

std::vector<std::string> ModelsThatAllocateNothing() {
  std::vector<std::string> names;
  for (const ModelTraits& model : AllContactModels()) {
    if (!model.allocates) names.emplace_back(model.name);
  }
  return names;
}

INSTANTIATE_TEST_SUITE_P(AllModels, AllocationOf, testing::ValuesIn(ModelsThatAllocateNothing()),
                         [](const auto& test) { return test.param; });

}  // namespace
}  // namespace saltus
