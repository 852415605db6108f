// Free flight of several motions at once against one after the other, with the instructions of any processor and with
// those of this one.
#include "saltus/internal/flight_lanes.h"

#include <gtest/gtest.h>

#include <vector>

#include "base/random.h"
#include "base/same_bits.h"
#include "contact/event/event.h"
#include "contact/models/compliant_warp.h"
#include "contact/models/convex.h"
#include "contact/models/direct.h"
#include "contact/models/dual_descent.h"
#include "contact/models/ipc_barrier.h"
#include "contact/models/lcp.h"
#include "contact/models/lcp_kkt.h"
#include "contact/models/lcp_pgs.h"
#include "contact/models/ncp.h"
#include "contact/models/pbd_warp.h"
#include "contact/models/position_qp.h"
#include "contact/models/primal_descent.h"
#include "contact/models/qcqp.h"
#include "contact/models/smooth_compliant.h"
#include "contact/models/soft_convex.h"
#include "contact/models/static_lcp.h"
#include "contact/models/toi_velocity.h"
#include "contact/models/xpbd.h"

namespace saltus {
namespace {

using State = BodyState<double, 0>;

template <typename M>
class FlightLanes : public testing::Test {};
using Models =
    testing::Types<Lcp, Convex<false>, Convex<true>, Direct<false>, Direct<true>, CompliantWarp, PbdWarp, ToiVelocity,
                   EventDriven, LcpKkt, LcpPgs<false>, LcpPgs<true>, Ncp<false>, Ncp<true>, SoftConvex, Qcqp,
                   SmoothCompliant, IpcBarrier, Xpbd, PositionQp, PrimalDescent, DualDescent, StaticLcp>;
TYPED_TEST_SUITE(FlightLanes, Models);

TYPED_TEST(FlightLanes, HasTheBitsOfSingleFlights) {
  constexpr int kSteps[][kLanes] = {{7, 7, 7, 7}, {1, 2, 3, 4}, {9, 0, 3, 3}, {0, 0, 5, 0}, {2, 6, 6, 1}};
  constexpr std::ptrdiff_t kStride = 3;
  const TypeParam model;
  NormalStream normals(3);
  const auto random = [&] { return Vec2d(normals.Next(), normals.Next()); };
  for (const auto& steps : kSteps) {
    for (const bool pushed : {true, false}) {
      for (const bool fixed : {false, true}) {
        const double unit = pushed ? 0.7 : 1.0;
        const BodyConstants<double> body{1.7, fixed ? 0.0 : 1 / 1.7, 0.1, fixed};
        FlightsInput flights;
        flights.step.h = 1.0 / 480;
        flights.step.gravity = random();
        flights.step.bodies = {&body, 1};
        flights.stride = kStride;
        flights.unit = unit;
        std::vector<std::vector<double>> forces(kLanes);
        std::vector<State> expected, together, baseline;
        for (int lane = 0; lane < kLanes; ++lane) {
          flights.steps[lane] = steps[lane];
          // Not a number more than is needed, so that a sanitizer finds what reads beyond.
          for (std::ptrdiff_t i = 0; i < (steps[lane] - 1) * kStride + 2; ++i) forces[lane].push_back(normals.Next());
          if (pushed && steps[lane] > 0) flights.force[lane] = forces[lane].data();
          State x{random(), random()};
          together.push_back(x);
          Vec2d force = Vec2d::Zero();
          StepInput<double> in = flights.step;
          in.force = {&force, 1};
          for (int k = 0; k < steps[lane]; ++k) {
            const double* const u = &forces[lane][k * kStride];
            if (pushed) force = {unit * u[0], unit * u[1]};
            x = model.Free(in, 0, x);
          }
          expected.push_back(x);
        }
        baseline = together;
        const auto pointers = [&](std::vector<State>& all) {
          std::array<State*, kLanes> at{};
          for (int lane = 0; lane < kLanes; ++lane) at[lane] = steps[lane] > 0 ? &all[lane] : nullptr;
          return at;
        };
        internal::FlyTogether(model, flights, pointers(together));
        internal::FlyInLanes(model, flights, pointers(baseline));
        EXPECT_TRUE(SameBits<State>(together, expected)) << "pushed " << pushed << ", fixed " << fixed;
        EXPECT_TRUE(SameBits<State>(baseline, expected)) << "pushed " << pushed << ", fixed " << fixed;
      }
    }
  }
}

}  // namespace
}  // namespace saltus
