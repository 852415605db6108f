// Neither a rollout nor its gradient asks for memory once it has been evaluated before.
#include <gtest/gtest.h>

#include <atomic>
#include <cstdlib>
#include <memory>

#include "saltus/control/single_shooting.h"
#include "saltus/simulate/registry.h"
#include "scene/scene_generators.h"
#include "test_scenes.h"

namespace {

std::atomic<long> allocations = 0;

}  // namespace

// The functions of glibc under other names: all memory comes through here, that of Eigen's matrices too.
extern "C" {
void* __libc_malloc(std::size_t size);
void* __libc_calloc(std::size_t count, std::size_t size);
void* __libc_realloc(void* memory, std::size_t size);
void* __libc_memalign(std::size_t alignment, std::size_t size);

void* malloc(std::size_t size) {
  ++allocations;
  return __libc_malloc(size);
}
void* calloc(std::size_t count, std::size_t size) {
  ++allocations;
  return __libc_calloc(count, size);
}
void* realloc(void* memory, std::size_t size) {
  ++allocations;
  return __libc_realloc(memory, size);
}
void* aligned_alloc(std::size_t alignment, std::size_t size) {
  ++allocations;
  return __libc_memalign(alignment, size);
}
int posix_memalign(void** memory, std::size_t alignment, std::size_t size) {
  ++allocations;
  *memory = __libc_memalign(alignment, size);
  return *memory == nullptr ? ENOMEM : 0;
}
}

namespace saltus {
namespace {

TEST(Allocation, IsCounted) {
  const long before = allocations;
  std::vector<double> some(100);
  EXPECT_EQ(allocations, before + 1) << some[0];
  struct alignas(64) Aligned {
    double x = 0;
  };
  auto aligned = std::make_unique<Aligned>();
  EXPECT_EQ(allocations, before + 2) << aligned->x;
  Eigen::VectorXd matrix(100);
  EXPECT_EQ(allocations, before + 3) << matrix.size();
}

// Four discs one on the other, which lean, come down and stay.
Scene Tower(double friction) {
  Scene scene;
  scene.name = "tower";
  scene.duration = 0.25;
  scene.steps = 60;
  scene.gravity = {0, -9.8};
  for (int i = 0; i < 4; ++i) {
    scene.bodies.push_back({.name = "disc" + std::to_string(i),
                            .radius = 0.1,
                            .mass = 1,
                            .position = {0.02 * i, 0.1 * (2 * i + 1) + 0.01 * i}});
  }
  scene.planes = {{"ground", {0, 0}, {0, 1}}};
  scene.contact.restitution = 0.3;
  scene.contact.friction = friction;
  scene.objective.terminal = {{.body = 3}};
  scene.optimize = Optimize::kVelocity;
  return scene;
}

class AllocationOf : public testing::TestWithParam<std::string> {
 protected:
  // Evaluates twice to settle, then counts.
  void ExpectNone(const Scene& scene, Precision precision) {
    if (!ReasonNotApplicable(GetParam(), scene).empty()) return;
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
    for (const double friction : {0.0, 0.3}) ExpectNone(Tower(friction), precision);
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
