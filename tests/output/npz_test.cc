#include "output/npz.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdio>
#include <limits>
#include <numbers>
#include <utility>

#include "base/file.h"
#include "folders.h"

namespace saltus {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

std::string FromHex(const std::string& hex) {
  std::string bytes;
  for (size_t i = 0; i < hex.size(); i += 2) bytes += static_cast<char>(std::stoi(hex.substr(i, 2), nullptr, 16));
  return bytes;
}

// The output of NumPy 1.24 for numpy.save(numpy.array([[1.5, -2.0, numpy.pi]])).
const char kNumpyDoubles[] =
    "934e554d5059010076007b276465736372273a20273c6638272c2027666f727472616e5f6f72646572273a2046616c73652c20277368"
    "617065273a2028312c2033292c207d202020202020202020202020202020202020202020202020202020202020202020202020202020"
    "202020202020202020202020202020202020200a000000000000f83f00000000000000c0182d4454fb210940";

// The output for numpy.array([7, -1], dtype=numpy.int64).
const char kNumpyIntegers[] =
    "934e554d5059010076007b276465736372273a20273c6938272c2027666f727472616e5f6f72646572273a2046616c73652c20277368"
    "617065273a2028322c292c207d2020202020202020202020202020202020202020202020202020202020202020202020202020202020"
    "202020202020202020202020202020202020200a0700000000000000ffffffffffffffff";

// The output for numpy.array(["event", "ü≤😀", ""]).
const char kNumpyText[] =
    "934e554d5059010076007b276465736372273a20273c5535272c2027666f727472616e5f6f72646572273a2046616c73652c20277368"
    "617065273a2028332c292c207d2020202020202020202020202020202020202020202020202020202020202020202020202020202020"
    "202020202020202020202020202020202020200a6500000076000000650000006e00000074000000fc0000006422000000f601000000"
    "0000000000000000000000000000000000000000000000000000";

// numpy.savez_compressed(loss=numpy.array([0.25], dtype=numpy.float32), s=numpy.float64(3)).
const char kNumpyArchive[] =
    "504b030414000000080000002100c70650044800000084000000080014006c6f73732e6e707901001000840000000000000048000000"
    "000000009bec17ea1b10c9c850c650ad9e925a9c5ca46ea5a06e9366a2aea3a09e965f54529498179f5f94920a12774bcc294e058a17"
    "672416a402f91a863a9a3a0ab50a14002e0686063b00504b03041400000008000000210039fb8f3f470000008800000005001400732e"
    "6e707901001000880000000000000047000000000000009bec17ea1b10c9c850c650ad9e925a9c5ca46ea5a06e9366a1aea3a09e965f"
    "54529498179f5f94920a12774bcc294e058a17672416a402f91a9a3a0ab50a14012e0630e0700000504b010214031400000008000000"
    "2100c706500448000000840000000800000000000000000000008001000000006c6f73732e6e7079504b010214031400000008000000"
    "210039fb8f3f4700000088000000050000000000000000000000800182000000732e6e7079504b050600000000020002006900000000"
    "0100000000";

TEST(NpyTest, WritesTheBytesThatNumpyWrites) {
  EXPECT_EQ(EncodeNpy({{1, 3}, std::vector<double>{1.5, -2.0, std::numbers::pi}}), FromHex(kNumpyDoubles));
  EXPECT_EQ(EncodeNpy({{2}, std::vector<int64_t>{7, -1}}), FromHex(kNumpyIntegers));
}

TEST(NpyTest, ReadsWhatNumpyWrites) {
  const StatusOr<NpyArray> doubles = DecodeNpy(FromHex(kNumpyDoubles));
  ASSERT_TRUE(doubles.ok()) << doubles.status().message();
  EXPECT_THAT(doubles->shape, ElementsAre(1, 3));
  EXPECT_THAT(std::get<std::vector<double>>(doubles->data), ElementsAre(1.5, -2.0, std::numbers::pi));
  const StatusOr<NpyArray> integers = DecodeNpy(FromHex(kNumpyIntegers));
  ASSERT_TRUE(integers.ok()) << integers.status().message();
  EXPECT_THAT(std::get<std::vector<int64_t>>(integers->data), ElementsAre(7, -1));
}

TEST(NpyTest, TextIsAsNumpyHasIt) {
  const NpyArray array{{3}, std::vector<std::string>{"event", "ü≤😀", ""}};
  EXPECT_EQ(EncodeNpy(array), FromHex(kNumpyText));
  const StatusOr<NpyArray> read = DecodeNpy(FromHex(kNumpyText));
  ASSERT_TRUE(read.ok()) << read.status().message();
  EXPECT_EQ(*read, array);
}

TEST(NpyTest, TextThatIsNotUtf8BecomesReplacementCharacters) {
  const std::string cut_off = "a\xe2\x89", lone = "\x80z", no_lead = "\xff";
  const StatusOr<NpyArray> read = DecodeNpy(EncodeNpy({{3}, std::vector<std::string>{cut_off, lone, no_lead}}));
  ASSERT_TRUE(read.ok()) << read.status().message();
  EXPECT_THAT(std::get<std::vector<std::string>>(read->data), ElementsAre("a\ufffd", "\ufffdz", "\ufffd"));
}

TEST(NpyTest, DataStartAtAMultipleOf64AfterALineFeed) {
  NpyArray array{{}, std::vector<float>(1, 1.0f)};
  for (int dimensions = 0; dimensions < 40; ++dimensions) {
    const std::string bytes = EncodeNpy(array);
    const size_t start = bytes.size() - sizeof(float);
    EXPECT_EQ(start % 64, 0u) << dimensions;
    EXPECT_EQ(bytes[start - 1], '\n') << dimensions;
    EXPECT_EQ(static_cast<unsigned char>(bytes[8]) + 256u * static_cast<unsigned char>(bytes[9]) + 10, start);
    const StatusOr<NpyArray> read = DecodeNpy(bytes);
    ASSERT_TRUE(read.ok()) << read.status().message();
    EXPECT_EQ(*read, array);
    array.shape.push_back(1);
  }
}

TEST(NpyTest, RefusesWhatItCannotRead) {
  const auto message = [](const std::string& bytes) { return DecodeNpy(bytes).status().message(); };
  std::string bytes = FromHex(kNumpyDoubles);
  const auto replaced = [&](const std::string& from, const std::string& to) {
    return std::string(bytes).replace(bytes.find(from), from.size(), to);
  };
  EXPECT_THAT(message("not NPY at all"), HasSubstr("not an NPY file"));
  EXPECT_THAT(message(replaced(std::string("NUMPY\x01"), "NUMPY\x02")), HasSubstr("not an NPY file"));
  EXPECT_THAT(message(bytes.substr(0, 60)), HasSubstr("cut off"));
  EXPECT_THAT(message(bytes.substr(0, bytes.size() - 1)), HasSubstr("does not fit"));
  EXPECT_THAT(message(replaced("(1, 3)", "(1, 2)")), HasSubstr("does not fit"));
  EXPECT_THAT(message(replaced("<f8", ">f8")), HasSubstr("'>f8'"));
  EXPECT_THAT(message(replaced("False", "Maybe")), HasSubstr("not understood"));
  EXPECT_THAT(message(replaced("False, 'shape': (1, 3), }", "True, 'shape': (1, 3), } ")), HasSubstr("Fortran"));
  const std::string huge = "(99999999999999999999, 1), }";
  EXPECT_THAT(message(replaced("(1, 3), }" + std::string(huge.size() - 9, ' '), huge)), HasSubstr("out of range"));
}

// A header is a dictionary, whose keys may stand in any order.
TEST(NpyTest, ReadsKeysInAnyOrder) {
  std::string bytes = FromHex(kNumpyDoubles);
  const std::string before = "'descr': '<f8', 'fortran_order': False", after = "'fortran_order': False, 'descr': '<f8'";
  ASSERT_NE(bytes.find(before), std::string::npos);
  const NpyArray expected = *DecodeNpy(bytes);
  const StatusOr<NpyArray> read = DecodeNpy(bytes.replace(bytes.find(before), before.size(), after));
  ASSERT_TRUE(read.ok()) << read.status().message();
  EXPECT_EQ(*read, expected);
}

class NpzTest : public testing::Test {
 protected:
  ~NpzTest() override { std::remove(path_.c_str()); }
  std::string path_ = TempFile("npz_test.npz");
};

// Neither as much memory as a header asks for nor as much stack as it is long.
TEST(NpyTest, AHeaderCostsNoMoreThanItsBytes) {
  const auto with_header = [](const std::string& header) {
    std::string bytes("\x93NUMPY\x01\x00", 8);
    bytes += static_cast<char>(header.size() & 0xff);
    bytes += static_cast<char>(header.size() >> 8);
    return bytes + header;
  };
  EXPECT_FALSE(DecodeNpy(with_header("{'descr': '" + std::string(65000, 'x'))).ok());
  EXPECT_FALSE(
      DecodeNpy(with_header("{'descr': '<f8', 'fortran_order': False, 'shape': (" + std::string(60000, '1') + "), }\n"))
          .ok());
  const StatusOr<NpyArray> none =
      DecodeNpy(with_header("{'descr': '<U2000000000', 'fortran_order': False, 'shape': (0,), }\n"));
  ASSERT_TRUE(none.ok()) << none.status().message();
  EXPECT_EQ(none->shape, std::vector<int64_t>{0});
}

TEST_F(NpzTest, RoundTripsEveryTypeAndShape) {
  const double infinity = std::numeric_limits<double>::infinity();
  const NpzArrays arrays = {{"loss", {{3}, std::vector<double>{0.1, -infinity, 5e-324}}},
                            {"last_traj", {{2, 1, 2}, std::vector<float>{0.1f, 2, 3, 4}}},
                            {"scalar", {{}, std::vector<int64_t>{std::numeric_limits<int64_t>::min()}}},
                            {"empty", {{0, 2}, std::vector<double>{}}}};
  const Status written = WriteNpz(path_, arrays);
  ASSERT_TRUE(written.ok()) << written.message();
  const StatusOr<NpzArrays> read = ReadNpz(path_);
  ASSERT_TRUE(read.ok()) << read.status().message();
  EXPECT_EQ(*read, arrays);
}

TEST_F(NpzTest, MembersAreStoredUnderTheirNameWithTheNpyBytes) {
  const NpyArray array{{2}, std::vector<double>{1, 2}};
  ASSERT_TRUE(WriteNpz(path_, {{"ctrls", array}}).ok());
  const std::string bytes = *ReadFile(path_);
  // Local file header: signature, version, flags, method 0 (stored), time, date; the name starts at byte 30.
  EXPECT_EQ(bytes.substr(0, 4), "PK\x03\x04");
  EXPECT_EQ(bytes.substr(8, 2), std::string(2, '\0'));
  EXPECT_EQ(bytes.substr(30, 9), "ctrls.npy");
  EXPECT_NE(bytes.find(EncodeNpy(array)), std::string::npos);
}

TEST_F(NpzTest, EqualArraysGiveEqualBytesAndReplaceWhatWasThere) {
  const NpzArrays arrays = {{"a", {{1}, std::vector<double>{1}}}};
  ASSERT_TRUE(WriteFile(path_, "not a zip file").ok());
  ASSERT_TRUE(WriteNpz(path_, arrays).ok());
  const std::string first = *ReadFile(path_);
  ASSERT_TRUE(WriteNpz(path_, {{"b", {{1}, std::vector<double>{2}}}}).ok());
  ASSERT_TRUE(WriteNpz(path_, arrays).ok());
  EXPECT_EQ(*ReadFile(path_), first);
}

TEST_F(NpzTest, ReadsWhatNumpyCompressed) {
  ASSERT_TRUE(WriteFile(path_, FromHex(kNumpyArchive)).ok());
  const StatusOr<NpzArrays> read = ReadNpz(path_);
  ASSERT_TRUE(read.ok()) << read.status().message();
  EXPECT_EQ(*read, (NpzArrays{{"loss", {{1}, std::vector<float>{0.25f}}}, {"s", {{}, std::vector<double>{3.0}}}}));
}

TEST_F(NpzTest, DamagedArchivesAreErrors) {
  ASSERT_TRUE(WriteNpz(path_, {{"a", {{4}, std::vector<double>{1, 2, 3, 4}}}}).ok());
  std::string bytes = *ReadFile(path_);
  bytes[bytes.find("NUMPY") + 130] ^= 1;  // in the data: only the checksum can tell
  ASSERT_TRUE(WriteFile(path_, bytes).ok());
  EXPECT_THAT(ReadNpz(path_).status().message(), HasSubstr("damaged"));
  ASSERT_TRUE(WriteFile(path_, bytes.substr(0, bytes.size() / 2)).ok());
  EXPECT_FALSE(ReadNpz(path_).ok());
  EXPECT_FALSE(ReadNpz("/no/such/file.npz").ok());
}

TEST_F(NpzTest, FailedWriteIsAnErrorThatNamesTheFile) {
  const Status status = WriteNpz("/no/such/folder/x.npz", {{"a", {{1}, std::vector<double>{1}}}});
  EXPECT_THAT(status.message(), HasSubstr("/no/such/folder/x.npz"));
}

TEST(NpzDeathTest, ShapeMustFitTheData) {
  EXPECT_DEATH(EncodeNpy({{2, 2}, std::vector<double>{1, 2, 3}}), "shape \\(2, 2\\) with 3 entries");
}

}  // namespace
}  // namespace saltus
