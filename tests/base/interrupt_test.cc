#include "base/interrupt.h"

#include <gtest/gtest.h>

#include <csignal>

namespace saltus {
namespace {

// A shell makes what it runs in the background ignore interrupts.
[[maybe_unused]] const auto inherited = std::signal(SIGINT, SIG_DFL);

volatile std::sig_atomic_t seen = 0;
void Remember(int signal) { seen = signal; }

TEST(InterruptGuardTest, FirstSignalOnlySetsTheFlag) {
  for (const int signal : {SIGINT, SIGTERM}) {
    const InterruptGuard guard;
    EXPECT_FALSE(guard.Interrupted());
    std::raise(signal);
    EXPECT_TRUE(guard.Interrupted());
  }
}

TEST(InterruptGuardTest, RestoresTheHandlerThatWasThere) {
  const auto original = std::signal(SIGINT, Remember);
  {
    const InterruptGuard guard;
    std::raise(SIGINT);
    EXPECT_EQ(seen, 0);
  }
  std::raise(SIGINT);
  EXPECT_EQ(seen, SIGINT);
  std::signal(SIGINT, original);
}

TEST(InterruptGuardTest, IgnoredSignalsStayIgnored) {
  const auto original = std::signal(SIGINT, SIG_IGN);
  const InterruptGuard guard;
  std::raise(SIGINT);
  EXPECT_FALSE(guard.Interrupted());
  std::signal(SIGINT, original);
}

TEST(InterruptGuardDeathTest, SecondSignalKills) {
  const auto raise_twice = [](int first, int second) {
    const InterruptGuard guard;
    std::raise(first);
    std::raise(second);
  };
  EXPECT_EXIT(raise_twice(SIGINT, SIGINT), testing::KilledBySignal(SIGINT), "");
  EXPECT_EXIT(raise_twice(SIGINT, SIGTERM), testing::KilledBySignal(SIGTERM), "");
}

}  // namespace
}  // namespace saltus
