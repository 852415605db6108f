#include "output/progress.h"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cstdlib>
#include <thread>
#include <vector>

namespace saltus {
namespace {

using testing::AllOf;
using testing::EndsWith;
using testing::HasSubstr;
using testing::Not;
using testing::StartsWith;

// Time stands still unless told.
class FakeClock {
 public:
  void Wait(double seconds) {
    now_ += std::chrono::duration_cast<std::chrono::steady_clock::duration>(std::chrono::duration<double>(seconds));
  }
  Progress::Clock Reader() {
    return [this] { return now_; };
  }

 private:
  std::chrono::steady_clock::time_point now_{};
};

class ProgressTest : public testing::Test {
 protected:
  ProgressTest() : sink_(std::tmpfile()) {}
  ~ProgressTest() override { std::fclose(sink_); }

  std::string Written() {
    std::string text;
    std::rewind(sink_);
    for (int c = 0; (c = std::fgetc(sink_)) != EOF;) text += static_cast<char>(c);
    return text;
  }

  std::FILE* sink_;
  FakeClock clock_;
};

TEST(ProgressBarTest, ShowsShareRateAndTimeLeft) {
  EXPECT_EQ(ProgressBar({"sweep", 500, 1000, 4.0, "lcp"}, 61),
            "sweep [=======>        ] 500/1000  50%  125/s  0:04 left  lcp");
  EXPECT_EQ(ProgressBar({"sweep", 3, 0, 2.0, ""}, 60), "sweep 3  1.5/s  0:02");
}

TEST(ProgressBarTest, NeverExceedsTheColumns) {
  const ProgressState state{
      "\xC3\xA9t\xC3\xA9", 999, 1000, 7200.0, "a note that is quite long for so small a terminal"};
  for (size_t columns = 0; columns < 120; ++columns) {
    const std::string bar = ProgressBar(state, columns);
    size_t width = 0;
    for (const char c : bar) width += (static_cast<unsigned char>(c) & 0xc0) != 0x80;
    EXPECT_LE(width, columns) << bar;
  }
}

TEST(ProgressLineTest, CoversEveryStage) {
  EXPECT_EQ(ProgressLine({"audit", 0, 10, 0.0, ""}), "audit: 0/10   0%  0:00");
  EXPECT_EQ(ProgressLine({"audit", 5, 10, 2.0, "lcp"}), "audit: 5/10  50%  2.5/s  0:02 left  lcp");
  EXPECT_EQ(ProgressLine({"audit", 1, 3601, 2.0, ""}), "audit: 1/3601   0%  0.5/s  2:00:00 left");
  EXPECT_EQ(ProgressLine({"audit", 10, 10, 83.0, "done"}), "audit: 10/10 100%  0.12/s  1:23  done");
  EXPECT_EQ(ProgressLine({"audit", 999, 1000, 1.0, ""}), "audit: 999/1000  99%  999/s  0:00 left");
  EXPECT_EQ(ProgressLine({"audit", 7, 0, 7.0, ""}), "audit: 7  1/s  0:07");
}

TEST_F(ProgressTest, PlainWritesALineEveryFiveSecondsAndOneAtTheEnd) {
  {
    Progress progress(ProgressMode::kPlain, sink_, "audit", 12, clock_.Reader());
    for (int i = 1; i <= 12; ++i) {
      clock_.Wait(1.0);
      progress.Advance(1, i % 2 == 0 ? "even" : "odd");
    }
  }
  EXPECT_EQ(Written(),
            "audit: 5/12  41%  1/s  0:07 left  odd\n"
            "audit: 10/12  83%  1/s  0:02 left  even\n"
            "audit: 12/12 100%  1/s  0:12  done\n");
}

TEST_F(ProgressTest, AutoIsPlainOnAFileAndSaysIfItStoppedEarly) {
  Progress progress(ProgressMode::kAuto, sink_, "audit", 10, clock_.Reader());
  clock_.Wait(1.0);
  progress.Advance(5);
  progress.Finish();
  progress.Advance();
  progress.Finish();
  EXPECT_EQ(Written(), "audit: 5/10  50%  5/s  0:01  stopped\n");
}

// Two units that take 10 s each: what is left of the second one gets less as it is worked on.
TEST_F(ProgressTest, TheTimeLeftIsThatOfTheUnitsDoneLessWhatHasPassedSince) {
  Progress progress(ProgressMode::kPlain, sink_, "sweep", 2, clock_.Reader());
  clock_.Wait(10.0);
  progress.Advance();
  clock_.Wait(6.0);
  progress.Advance(0);
  clock_.Wait(6.0);
  progress.Advance(0);  // it takes longer than the first one: how long is not known
  EXPECT_EQ(Written(),
            "sweep: 1/2  50%  0.1/s  0:10 left\n"
            "sweep: 1/2  50%  0.0625/s  0:04 left\n"
            "sweep: 1/2  50%  0.0455/s  0:22\n");
}

// An exact gradient that is found at once says nothing of how long an audit takes.
TEST_F(ProgressTest, NothingIsSaidOfTheTimeLeftOfUnitsThatDiffer) {
  Progress progress(ProgressMode::kPlain, sink_, "audit", 2, clock_.Reader());
  progress.UnitsDiffer();
  clock_.Wait(1.0);
  progress.Advance();
  clock_.Wait(9.0);
  progress.Advance(0, "lcp");
  EXPECT_EQ(Written(), "audit: 1/2  50%  0:10  lcp\n");
}

TEST_F(ProgressTest, NoneWritesNothing) {
  {
    Progress progress(ProgressMode::kNone, sink_, "audit", 10, clock_.Reader());
    clock_.Wait(100.0);
    progress.Advance(5);
  }
  EXPECT_EQ(Written(), "");
}

TEST_F(ProgressTest, CountsFromManyThreads) {
  {
    Progress progress(ProgressMode::kPlain, sink_, "sweep", 4000, clock_.Reader());
    std::vector<std::thread> threads;
    for (int i = 0; i < 4; ++i) {
      threads.emplace_back([&] {
        for (int j = 0; j < 1000; ++j) progress.Advance(1, "working");
      });
    }
    for (std::thread& thread : threads) thread.join();
  }
  EXPECT_EQ(Written(), "sweep: 4000/4000 100%  0:00  done\n");
}

TEST(ProgressTerminalTest, RedrawsOneLine) {
  const int terminal = posix_openpt(O_RDWR | O_NOCTTY);
  ASSERT_GE(terminal, 0);
  ASSERT_EQ(grantpt(terminal), 0);
  ASSERT_EQ(unlockpt(terminal), 0);
  std::FILE* sink = std::fopen(ptsname(terminal), "w");
  ASSERT_NE(sink, nullptr);
  FakeClock clock;
  {
    Progress progress(ProgressMode::kAuto, sink, "sweep", 100, clock.Reader());
    progress.Advance();  // too early to be drawn
    clock.Wait(1.0);
    progress.Advance(49, "half");
    clock.Wait(1.0);
    progress.Advance(50);
  }
  std::fclose(sink);
  std::string text;
  char part[4096];
  // A terminal hands on what was written piece by piece; its end is an error (EIO).
  for (ssize_t size; (size = read(terminal, part, sizeof(part))) > 0;) text.append(part, static_cast<size_t>(size));
  close(terminal);
  EXPECT_THAT(text, AllOf(StartsWith("\rsweep ["), HasSubstr("50/100  50%"), HasSubstr("half\033[K\rsweep [")));
  EXPECT_THAT(text, AllOf(EndsWith("done\033[K\r\n"), Not(HasSubstr("1/100   1%"))));
}

TEST(ParseProgressModeTest, KnowsItsWords) {
  EXPECT_EQ(ParseProgressMode("auto"), ProgressMode::kAuto);
  EXPECT_EQ(ParseProgressMode("plain"), ProgressMode::kPlain);
  EXPECT_EQ(ParseProgressMode("none"), ProgressMode::kNone);
  EXPECT_EQ(ParseProgressMode("loud"), std::nullopt);
}

}  // namespace
}  // namespace saltus
