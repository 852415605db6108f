// The width of a terminal, and lines that fit it.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <pty.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <cstdlib>

#include "base/table.h"

namespace saltus {
namespace {

using testing::ElementsAre;

TEST(TextLayoutTest, LinesBreakBetweenWordsAndInsideThoseTooLong) {
  EXPECT_THAT(WrapText("", 5), ElementsAre(""));
  EXPECT_THAT(WrapText("time of impact", 20), ElementsAre("time of impact"));
  EXPECT_THAT(WrapText("time of impact", 14), ElementsAre("time of impact"));
  EXPECT_THAT(WrapText("time of impact", 13), ElementsAre("time of", "impact"));
  EXPECT_THAT(WrapText("of impact", 3), ElementsAre("of", "imp", "act"));
  EXPECT_THAT(WrapText("one\ntwo\n", 10), ElementsAre("one", "two", ""));
  EXPECT_THAT(WrapText("  indented text", 10), ElementsAre("  indented", "text"));
  EXPECT_THAT(WrapText("\xC3\xA9t\xC3\xA9\xC3\xA9t\xC3\xA9", 3), ElementsAre("\xC3\xA9t\xC3\xA9", "\xC3\xA9t\xC3\xA9"));
}

TEST(TextLayoutTest, ParagraphsStandBesideTheirLabel) {
  EXPECT_EQ(Paragraph("the normal is frozen", 12), "the normal\nis frozen\n");
  EXPECT_EQ(Paragraph("the normal is frozen", 16, 5, "lcp:"), "lcp: the normal\n     is frozen\n");
  EXPECT_EQ(Paragraph("the normal is frozen", 16, 5, "convex:"), "convex:\n     the normal\n     is frozen\n");
  EXPECT_EQ(Paragraph("a b c d", 3, 2, "x"), "x\na b\nc d\n") << "no room for an indent";
}

TEST(TextLayoutTest, TheWidthIsThatOfTheTerminalAndOfColumnsWhereSet) {
  int master = -1, slave = -1;
  winsize size{};
  size.ws_col = 57;
  ASSERT_EQ(openpty(&master, &slave, nullptr, nullptr, &size), 0);
  std::FILE* terminal = fdopen(slave, "w");
  EXPECT_EQ(TerminalColumns(terminal, 100), 57);
  std::fclose(terminal);
  close(master);
  std::FILE* file = std::tmpfile();
  EXPECT_EQ(TerminalColumns(file, 100), 100);
  std::fclose(file);

  setenv("COLUMNS", "60", 1);
  EXPECT_EQ(LayoutOfStandardOutput().width, 60);
  for (const char* wrong : {"", "0", "-3", "wide", "60x"}) {
    setenv("COLUMNS", wrong, 1);
    const size_t width = LayoutOfStandardOutput().width;
    unsetenv("COLUMNS");
    EXPECT_EQ(width, LayoutOfStandardOutput().width) << wrong;
  }
  setenv("NO_COLOR", "", 1);
  EXPECT_FALSE(LayoutOfStandardOutput().colour);
}

}  // namespace
}  // namespace saltus
