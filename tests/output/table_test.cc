#include "output/table.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <limits>

#include "io/csv.h"

namespace saltus {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::Not;

Table Sample() {
  Table table({{"contact"}, {"loss", 4}, {"steps"}, {"verdict"}});
  table.AddRow({"direct_toi", 2.05851234, 480, Cell("match").With(Tone::kGood)});
  table.AddRow({"lcp", -0.5, 48, Cell("a|b <c>, \"d\"").With(Tone::kBad)});
  table.AddRow({"\xC3\xA9v\xC3\xA9nement", Cell(), 1, ""});
  return table;
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
  EXPECT_THAT(Sample().ToText(true), HasSubstr("\033[32mmatch       \033[0m"));
  EXPECT_THAT(Sample().ToText(true), HasSubstr("\033[31ma|b"));
  EXPECT_THAT(Sample().ToText(false), Not(HasSubstr("\033")));
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

TEST(TableTest, HtmlEscapesAndMarksCells) {
  const std::string html = Sample().ToHtml();
  EXPECT_THAT(html, HasSubstr("<th scope=\"col\" class=\"number\">loss</th>"));
  EXPECT_THAT(html, HasSubstr("<td class=\"number\">2.059</td>"));
  EXPECT_THAT(html, HasSubstr("<td class=\"good\">match</td>"));
  EXPECT_THAT(html, HasSubstr("<td class=\"bad\">a|b &lt;c&gt;, &quot;d&quot;</td>"));
  EXPECT_THAT(html, HasSubstr("<td class=\"number\"></td>"));
  Table table({{"note"}});
  table.AddRow({Cell(std::string(41, 'x')).With(Tone::kMuted)});
  EXPECT_THAT(table.ToHtml(), HasSubstr("<td class=\"muted long\">xxx"));
}

TEST(TableTest, CsvQuotesAsRfc4180Asks) {
  EXPECT_EQ(Sample().ToCsv(),
            "contact,loss,steps,verdict\n"
            "direct_toi,2.05851234,480,match\n"
            "lcp,-0.5,48,\"a|b <c>, \"\"d\"\"\"\n"
            "\xC3\xA9v\xC3\xA9nement,,1,\n");
}

TEST(TableTest, CsvReadsBackAsItWas) {
  Table table({{"a, \"b\""}, {"number"}});
  const double numbers[] = {0.1, 1.0 / 3.0, -1e-300, std::numeric_limits<double>::denorm_min(), 1e22, 480.0};
  for (const double number : numbers) table.AddRow({"line\nbreak,\r\n \"quoted\"", number});
  const StatusOr<CsvDocument> read = ParseCsv(table.ToCsv());
  ASSERT_TRUE(read.ok()) << read.status().message();
  EXPECT_THAT(read->header, ElementsAre("a, \"b\"", "number"));
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
