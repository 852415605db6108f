#include "base/table.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <limits>

#include "base/csv.h"

namespace saltus {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::Not;

Table Sample() {
  Table table({{"contact"}, {"loss", 4}, {"steps"}, {"verdict"}});
  table.AddRow({"direct_toi", 2.05851234, 480, Cell("match").WithTone(Tone::kGood)});
  table.AddRow({"lcp", -0.5, 48, Cell("a|b <c>, \"d\"").WithTone(Tone::kBad)});
  table.AddRow({"\xC3\xA9v\xC3\xA9nement", Cell(), 1, ""});
  return table;
}

TEST(ColumnsOfTest, ReadsHeadersAndDigits) {
  const std::vector<Column> columns = ColumnsOf("contact; exact loss:8; e, finer:3");
  ASSERT_EQ(columns.size(), 3u);
  EXPECT_EQ(columns[0].header, "contact");
  EXPECT_EQ(columns[0].significant_digits, Column().significant_digits);
  EXPECT_EQ(columns[1].header, "exact loss");
  EXPECT_EQ(columns[1].significant_digits, 8);
  EXPECT_EQ(columns[2].header, "e, finer");
}

TEST(TableTest, TextIsAligned) {
  EXPECT_EQ(Sample().ToText(),
            "contact      loss  steps  verdict\n"
            "----------  -----  -----  ------------\n"
            "direct_toi  2.059    480  match\n"
            "lcp          -0.5     48  a|b <c>, \"d\"\n"
            "\xC3\xA9v\xC3\xA9nement              1\n");
}

TEST(TableTest, TextHasColourOnlyIfAskedFor) {
  EXPECT_THAT(Sample().ToText({.colour = true}), HasSubstr("\033[32mmatch\033[0m\n"));
  EXPECT_THAT(Sample().ToText({.colour = true}), HasSubstr("\033[31ma|b"));
  EXPECT_THAT(Sample().ToText({.colour = false}), Not(HasSubstr("\033")));
}

Table Wide() {
  Table table({{"contact model"}, {"solver"}, {"initial loss", 10}, {"exact loss", 10}, {"why"}}, 2);
  table.AddRow(
      {"direct", "gd", 2.059143506, 1.39911006, "time of impact ignored; normal frozen at the start of the step"});
  table.AddRow({"ncp:kappa=1e-6:kappa_grad=1e-4", "ceres_lm", -12345.6789, Cell(), ""});
  return table;
}

TEST(TableTest, TextThatDoesNotFitIsWrappedAndGoesOnBelowTheKeys) {
  EXPECT_EQ(Wide().ToText({.width = 70}),
            "contact model                   solver    initial loss  exact loss\n"
            "------------------------------  --------  ------------  ----------\n"
            "direct                          gd         2.059143506  1.39911006\n"
            "ncp:kappa=1e-6:kappa_grad=1e-4  ceres_lm   -12345.6789\n"
            "\n"
            "contact model                   solver    why\n"
            "------------------------------  --------  ----------------------------\n"
            "direct                          gd        time of impact ignored;\n"
            "                                          normal frozen at the start\n"
            "                                          of the step\n"
            "ncp:kappa=1e-6:kappa_grad=1e-4  ceres_lm\n");
  EXPECT_EQ(Wide().ToText({.width = 1000}).find("\n\n"), std::string::npos);
  EXPECT_TRUE(Wide().FitsOneLine(1000));
  EXPECT_FALSE(Wide().FitsOneLine(70));
}

// Whatever the width, every character is there in order, and lines are no wider while the numbers have room.
TEST(TableTest, NothingIsCutOff) {
  const auto without_space = [](std::string text) {
    std::erase_if(text, [](char c) { return c == ' ' || c == '\n'; });
    return text;
  };
  Table table({{"a"}, {"b"}});
  const std::string sentence = "rebounds at 0.000 of the closing speed, \xC3\xA9tudi\xC3\xA9, where 1.00 is asked for";
  table.AddRow({"k", sentence});
  for (size_t width = 1; width < 120; ++width) {
    const std::string text = table.ToText({.width = width});
    std::string seen;  // in the second column, below the rule
    size_t begin = text.find('\n', text.find('\n') + 1) + 1;
    for (size_t end; begin < text.size(); begin = end + 1) {
      end = text.find('\n', begin);
      const std::string line = text.substr(begin, end - begin);
      EXPECT_LE(DisplayWidth(line), std::max<size_t>(width, 7)) << width;
      seen += line.substr(line[0] == 'k' ? 1 : 0);
    }
    EXPECT_EQ(without_space(seen), without_space(sentence)) << width;
  }
}

TEST(TableTest, ColumnsWithoutContentAreLeftOutOfText) {
  Table table({{"key"}, {"empty"}, {"full"}});
  EXPECT_EQ(table.ToText(), "key  empty  full\n---  -----  ----\n");
  table.AddRow({"", Cell(), 1});
  EXPECT_EQ(table.ToText(), "key  full\n---  ----\n        1\n");
  EXPECT_EQ(table.ToCsv(), "key,empty,full\n,,1\n");
}

TEST(TableTest, TransposedNumbersKeepTheirDigitsAndTones) {
  Table table({{"contact"}, {"loss", 4}, {"angle, rad", 2}});
  table.AddRow({"exact (event)", 2.05851234, Cell()});
  table.AddRow({"lcp", -0.5, Cell(0.123456).WithTone(Tone::kBad)});
  table.AddRow({"direct", Cell(), -1.0 / 3});
  const Table transposed = table.Transposed("entry", 2);
  EXPECT_EQ(transposed.ToText({.width = 28}),
            "entry            exact   lcp\n"
            "               (event)\n"
            "----------  ----------  ----\n"
            "loss             2.059  -0.5\n"
            "angle, rad              0.12\n"
            "\n"
            "entry          exact  direct\n"
            "             (event)\n"
            "----------  --------  ------\n"
            "loss           2.059\n"
            "angle, rad             -0.33\n");
  EXPECT_THAT(transposed.ToText({.colour = true}), HasSubstr("\033[31m0.12\033[0m"));
  EXPECT_EQ(transposed.ToCsv(),
            "entry,exact (event),lcp,direct\n"
            "loss,2.05851234,-0.5,\n"
            "\"angle, rad\",,0.123456,-0.3333333333333333\n");
}

TEST(TableTest, MarkdownEscapesMarkupAndAlignsNumbers) {
  EXPECT_EQ(Sample().ToMarkdown(),
            "| contact    |  loss | steps | verdict        |\n"
            "|------------|------:|------:|----------------|\n"
            "| direct_toi | 2.059 |   480 | match          |\n"
            "| lcp        |  -0.5 |    48 | a\\|b \\<c>, \"d\" |\n"
            "| \xC3\xA9v\xC3\xA9nement  |       |     1 |                |\n");
  Table table({{"_x_"}});
  table.AddRow({"two\nlines"});
  EXPECT_THAT(table.ToMarkdown(), HasSubstr("| \\_x\\_"));
  EXPECT_THAT(table.ToMarkdown(), HasSubstr("two<br>lines"));
}

TEST(TableTest, CsvQuotesAsRfc4180Asks) {
  EXPECT_EQ(Sample().ToCsv(),
            "contact,loss,steps,verdict\n"
            "direct_toi,2.05851234,480,match\n"
            "lcp,-0.5,48,\"a|b <c>, \"\"d\"\"\"\n"
            "\xC3\xA9v\xC3\xA9nement,,1,\n");
}

TEST(TableTest, CsvReadsBackAsItWas) {
  Table table({{"a, \"b\""}, {"\"number\""}});
  const double numbers[] = {0.1, 1.0 / 3.0, -1e-300, std::numeric_limits<double>::denorm_min(), 1e22, 480.0};
  for (const double number : numbers) table.AddRow({"line\nbreak,\r\n \"quoted\"", number});
  const StatusOr<CsvDocument> read = ParseCsv(table.ToCsv());
  ASSERT_TRUE(read.ok()) << read.status().message();
  EXPECT_THAT(read->header, ElementsAre("a, \"b\"", "\"number\""));
  ASSERT_EQ(read->rows.size(), std::size(numbers));
  for (size_t i = 0; i < std::size(numbers); ++i) {
    EXPECT_EQ(read->rows[i][0], "line\nbreak,\r\n \"quoted\"");
    EXPECT_EQ(std::strtod(read->rows[i][1].c_str(), nullptr), numbers[i]);
  }
}

TEST(TableTest, OneEmptyColumnSurvivesCsv) {
  Table table({{"only"}});
  table.AddRow({""});
  const StatusOr<CsvDocument> read = ParseCsv(table.ToCsv());
  ASSERT_TRUE(read.ok());
  EXPECT_EQ(read->rows.size(), 1u);
}

TEST(TableTest, CellsTakeOptionalValuesAndNonFiniteNumbers) {
  EXPECT_EQ(Cell(std::optional<double>()).Display(6), "");
  EXPECT_EQ(Cell(std::optional<double>(0.5)).Display(6), "0.5");
  EXPECT_EQ(Cell(std::numeric_limits<double>::infinity()).Display(6), "inf");
  EXPECT_EQ(Cell(1.5f).Exact(), "1.5");
}

}  // namespace
}  // namespace saltus
