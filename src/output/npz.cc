#include "output/npz.h"

#include <glog/logging.h>
#include <zip.h>

#include <algorithm>
#include <bit>
#include <boost/locale/utf.hpp>
#include <cstring>
#include <iterator>
#include <limits>
#include <memory>
#include <new>
#include <nlohmann/json.hpp>
#include <optional>
#include <string_view>
#include <type_traits>

#include "base/file.h"
#include "base/interrupt.h"
#include "base/number_text.h"

namespace saltus {
namespace {

// ---- Text: UTF-32, all entries of one length, padded with zeros (NumPy's type str_, '<U<length>')

using Utf8 = boost::locale::utf::utf_traits<char>;

constexpr std::string_view kNpyTextType = "<U";
constexpr char32_t kReplacement = 0xfffd;
constexpr char32_t kLargestCharacter = 0x10ffff;

// Encodes texts of `width` characters each, that of the longest; bytes that are not UTF-8 become U+FFFD.
std::string EncodeTexts(const std::vector<std::string>& texts, size_t* width) {
  std::vector<std::u32string> wide;
  *width = 1;
  for (const std::string& text : texts) {
    wide.emplace_back();
    for (auto at = text.begin(); at != text.end();) {
      const auto character = Utf8::decode(at, text.end());  // beyond the largest if there is none
      wide.back() += character <= kLargestCharacter ? char32_t{character} : kReplacement;
    }
    *width = std::max(*width, wide.back().size());
  }
  std::string bytes;
  for (std::u32string& text : wide) {
    text.resize(*width, U'\0');
    bytes.append(reinterpret_cast<const char*>(text.data()), text.size() * sizeof(char32_t));
  }
  return bytes;
}

// ---- Headers and data

static_assert(std::endian::native == std::endian::little, "NPY data are written as they lie in memory");

constexpr std::string_view kMagic{"\x93NUMPY\x01\x00", 8};  // and version 1.0
constexpr size_t kPrefix = 10;                              // magic, version, two bytes of header length
constexpr size_t kAlignment = 64;
constexpr std::string_view kSuffix = ".npy";
constexpr zip_uint16_t kDosEpoch = 0x21;  // 1980-01-01, the first date that a zip file can hold

template <typename T>
constexpr std::string_view Descriptor() {
  if constexpr (std::is_same_v<T, double>) return "<f8";
  if constexpr (std::is_same_v<T, float>) return "<f4";
  if constexpr (std::is_same_v<T, int64_t>) return "<i8";
}

std::string ShapeTuple(const std::vector<int64_t>& shape) {
  std::string tuple = "(";
  for (size_t i = 0; i < shape.size(); ++i) tuple += (i > 0 ? ", " : "") + std::to_string(shape[i]);
  return tuple + (shape.size() == 1 ? ",)" : ")");
}

// Returns the product of the dimensions; std::nullopt if it overflows.
std::optional<int64_t> Count(const std::vector<int64_t>& shape) {
  int64_t count = 1;
  for (const int64_t dimension : shape) {
    if (__builtin_mul_overflow(count, dimension, &count)) return std::nullopt;
  }
  return count;
}

std::string Header(std::string_view descriptor, const std::vector<int64_t>& shape) {
  std::string dictionary =
      "{'descr': '" + std::string(descriptor) + "', 'fortran_order': False, 'shape': " + ShapeTuple(shape) + ", }";
  const size_t unpadded = kPrefix + dictionary.size() + 1;
  dictionary.append((kAlignment - unpadded % kAlignment) % kAlignment, ' ');
  dictionary += '\n';
  CHECK_LE(dictionary.size(), std::numeric_limits<uint16_t>::max()) << "too many dimensions for NPY 1.0";
  std::string header(kMagic);
  header += static_cast<char>(dictionary.size() & 0xff);
  header += static_cast<char>(dictionary.size() >> 8);
  return header + dictionary;
}

struct HeaderFields {
  std::string descriptor;
  std::vector<int64_t> shape;
};

// Parses a header, a dictionary in Python: {'descr': '<f8', 'fortran_order': False, 'shape': (2, 3), } and a line end.
// It becomes JSON by other marks, and without commas at ends.
StatusOr<HeaderFields> ParseHeader(const std::string& header) {
  std::string json;
  for (const char c : header) {
    if (c == ')' || c == '}') {
      json.resize(json.find_last_not_of(' ') + 1);
      if (json.ends_with(',')) json.pop_back();
    }
    json += c == '\'' ? '"' : c == '(' ? '[' : c == ')' ? ']' : c;
  }
  for (const std::string word : {"True", "False"}) {
    if (const size_t at = json.find(": " + word); at != std::string::npos) json[at + 2] += 'a' - 'A';
  }
  const nlohmann::json fields = nlohmann::json::parse(json, nullptr, /*allow_exceptions=*/false);
  const bool whole = header.ends_with('\n') && fields.is_object() &&
                     fields.value("descr", nlohmann::json()).is_string() &&
                     fields.value("fortran_order", nlohmann::json()).is_boolean() &&
                     fields.value("shape", nlohmann::json()).is_array();
  if (!whole) return Status::Error("NPY header not understood: " + header);
  if (fields["fortran_order"].get<bool>()) return Status::Error("NPY data in Fortran order");
  HeaderFields parsed{fields["descr"], {}};
  for (const nlohmann::json& dimension : fields["shape"]) {
    if (!dimension.is_number_unsigned() || dimension.get<uint64_t>() > std::numeric_limits<int64_t>::max()) {
      return Status::Error("NPY shape out of range: " + fields["shape"].dump());
    }
    parsed.shape.push_back(dimension.get<int64_t>());
  }
  return parsed;
}

template <typename T>
StatusOr<NpyArray> DecodeData(std::vector<int64_t> shape, std::string_view bytes) {
  const std::optional<int64_t> count = Count(shape);
  if (!count || bytes.size() % sizeof(T) != 0 || bytes.size() / sizeof(T) != static_cast<uint64_t>(*count)) {
    return Status::Error("shape " + ShapeTuple(shape) + " does not fit " + std::to_string(bytes.size()) +
                         " bytes of data");
  }
  std::vector<T> data(static_cast<size_t>(*count));
  if (!data.empty()) std::memcpy(data.data(), bytes.data(), bytes.size());
  return NpyArray{std::move(shape), std::move(data)};
}

StatusOr<NpyArray> DecodeText(std::vector<int64_t> shape, const std::string& descriptor, std::string_view bytes) {
  const int width = FromText<int>(descriptor.substr(kNpyTextType.size())).value_or(0);
  if (width <= 0) return Status::Error("NPY type '" + descriptor + "' not understood");
  const size_t entry = static_cast<size_t>(width) * sizeof(char32_t), texts_in_bytes = bytes.size() / entry;
  const std::optional<int64_t> count = Count(shape);
  bool fits = bytes.size() % entry == 0 && count && texts_in_bytes == static_cast<uint64_t>(*count);
  std::vector<std::string> texts(fits ? texts_in_bytes : 0);
  for (size_t i = 0; i < bytes.size() && fits; i += sizeof(char32_t)) {
    char32_t c = 0;
    std::memcpy(&c, bytes.data() + i, sizeof c);
    fits = c <= kLargestCharacter;
    if (c == U'\0') {
      i += entry - i % entry - sizeof c;  // padding to the end of the entry
    } else if (fits) {
      Utf8::encode(c, std::back_inserter(texts[i / entry]));
    }
  }
  if (!fits) {
    return Status::Error("shape " + ShapeTuple(shape) + " does not fit " + std::to_string(bytes.size()) +
                         " bytes of text");
  }
  return NpyArray{std::move(shape), std::move(texts)};
}

struct ZipDiscard {
  void operator()(zip_t* archive) const { zip_discard(archive); }
};
using ZipHandle = std::unique_ptr<zip_t, ZipDiscard>;

struct ZipFree {
  void operator()(zip_source_t* source) const { zip_source_free(source); }
};
using ZipSource = std::unique_ptr<zip_source_t, ZipFree>;

Status ZipError(const std::string& path, zip_t* archive) { return Status::Error(path + ": " + zip_strerror(archive)); }

StatusOr<ZipHandle> OpenZip(const std::string& path) {
  int code = 0;
  if (zip_t* archive = zip_open(path.c_str(), ZIP_RDONLY, &code)) return ZipHandle(archive);
  zip_error_t error;
  zip_error_init_with_code(&error, code);
  const Status status = Status::Error(path + ": " + zip_error_strerror(&error));
  zip_error_fini(&error);
  return status;
}

// Adds a member; `bytes` must live until the archive is closed.
bool AddMember(zip_t* archive, const std::string& name, const std::string& bytes) {
  zip_source_t* source = zip_source_buffer(archive, bytes.data(), bytes.size(), /*freep=*/0);
  if (source == nullptr) return false;
  const zip_int64_t index = zip_file_add(archive, name.c_str(), source, ZIP_FL_ENC_UTF_8);
  if (index < 0) {
    zip_source_free(source);
    return false;
  }
  const zip_uint64_t member = static_cast<zip_uint64_t>(index);
  return zip_set_file_compression(archive, member, ZIP_CM_STORE, 0) == 0 &&
         zip_file_set_dostime(archive, member, /*dostime=*/0, kDosEpoch, 0) == 0;
}

// Returns all bytes of a source; std::nullopt if it cannot be read.
std::optional<std::string> ReadSource(zip_source_t* source) {
  zip_stat_t is;
  if (zip_source_stat(source, &is) != 0 || zip_source_open(source) != 0) return std::nullopt;
  std::string bytes(is.size, '\0');
  const zip_int64_t read = zip_source_read(source, bytes.data(), bytes.size());
  zip_source_close(source);
  if (read < 0 || static_cast<zip_uint64_t>(read) != is.size) return std::nullopt;
  return bytes;
}

// Reads member `index`; std::nullopt if the archive is damaged (libzip checks the CRC at the end of the data).
std::optional<std::string> ReadMember(zip_t* archive, zip_uint64_t index) {
  zip_file_t* file = zip_fopen_index(archive, index, 0);
  if (file == nullptr) return std::nullopt;
  std::string bytes;
  std::vector<char> buffer(1 << 16);
  zip_int64_t read = 0;
  while ((read = zip_fread(file, buffer.data(), buffer.size())) > 0) bytes.append(buffer.data(), read);
  const bool closed = zip_fclose(file) == 0;
  if (read < 0 || !closed) return std::nullopt;
  return bytes;
}

}  // namespace

std::string EncodeNpy(const NpyArray& array) {
  return std::visit(
      [&]<typename T>(const std::vector<T>& data) {
        for (const int64_t dimension : array.shape) CHECK_GE(dimension, 0);
        const std::optional<int64_t> count = Count(array.shape);
        CHECK(count && static_cast<uint64_t>(*count) == data.size())
            << "shape " << ShapeTuple(array.shape) << " with " << data.size() << " entries";
        if constexpr (std::is_same_v<T, std::string>) {
          size_t width = 0;
          const std::string bytes = EncodeTexts(data, &width);
          return Header(std::string(kNpyTextType) + std::to_string(width), array.shape) + bytes;
        } else {
          std::string bytes = Header(Descriptor<T>(), array.shape);
          bytes.append(reinterpret_cast<const char*>(data.data()), data.size() * sizeof(T));
          return bytes;
        }
      },
      array.data);
}

StatusOr<NpyArray> DecodeNpy(const std::string& bytes) {
  if (bytes.size() < kPrefix || std::string_view(bytes).substr(0, kMagic.size()) != kMagic) {
    return Status::Error("not an NPY file of version 1.0");
  }
  const size_t length = static_cast<unsigned char>(bytes[8]) + 256u * static_cast<unsigned char>(bytes[9]);
  if (bytes.size() < kPrefix + length) return Status::Error("NPY header is cut off");
  StatusOr<HeaderFields> fields = ParseHeader(bytes.substr(kPrefix, length));
  if (!fields.ok()) return fields.status();
  auto& [descriptor, shape] = *fields;
  const std::string_view data = std::string_view(bytes).substr(kPrefix + length);
  if (descriptor == Descriptor<double>()) return DecodeData<double>(std::move(shape), data);
  if (descriptor == Descriptor<float>()) return DecodeData<float>(std::move(shape), data);
  if (descriptor == Descriptor<int64_t>()) return DecodeData<int64_t>(std::move(shape), data);
  if (descriptor.starts_with(kNpyTextType)) return DecodeText(std::move(shape), descriptor, data);
  return Status::Error("NPY type '" + descriptor + "'; expected <f8, <f4, <i8 or <U");
}

Status WriteNpz(const std::string& path, const NpzArrays& arrays) {
  CHECK(!arrays.empty()) << path;
  // The archive is made in memory, because libzip would replace whatever is at `path`, devices too.
  const ZipSource whole(zip_source_buffer_create(nullptr, 0, /*freep=*/0, nullptr));
  if (whole == nullptr) throw std::bad_alloc();
  zip_source_keep(whole.get());  // the archive takes one reference
  ZipHandle archive(zip_open_from_source(whole.get(), ZIP_TRUNCATE, nullptr));
  if (archive == nullptr) {
    zip_source_free(whole.get());
    throw std::bad_alloc();
  }
  std::vector<std::string> members;
  members.reserve(arrays.size());  // libzip keeps pointers to the bytes
  for (const auto& [key, array] : arrays) {
    CHECK(!key.empty()) << path;
    members.push_back(EncodeNpy(array));
    if (!AddMember(archive.get(), key + std::string(kSuffix), members.back())) return ZipError(path, archive.get());
  }
  if (zip_close(archive.get()) != 0) return ZipError(path, archive.get());
  archive.release();
  members.clear();
  const std::optional<std::string> bytes = ReadSource(whole.get());
  if (!bytes) return Status::Error(path + ": " + zip_error_strerror(zip_source_error(whole.get())));
  return WriteFile(path, *bytes, InterruptGuard::Interrupted);
}

StatusOr<NpzArrays> ReadNpz(const std::string& path) {
  StatusOr<ZipHandle> archive = OpenZip(path);
  if (!archive.ok()) return archive.status();
  NpzArrays arrays;
  const zip_int64_t members = zip_get_num_entries(archive->get(), 0);
  for (zip_int64_t i = 0; i < members; ++i) {
    const char* name = zip_get_name(archive->get(), static_cast<zip_uint64_t>(i), 0);
    if (name == nullptr) return ZipError(path, archive->get());
    std::string key = name;
    if (!key.ends_with(kSuffix)) return Status::Error(path + ": member " + key + " is not an .npy file");
    const std::optional<std::string> bytes = ReadMember(archive->get(), static_cast<zip_uint64_t>(i));
    if (!bytes) return Status::Error(path + ": member " + key + " is damaged");
    StatusOr<NpyArray> array = DecodeNpy(*bytes);
    if (!array.ok()) return Status::Error(path + ": " + key + ": " + array.status().message());
    key.resize(key.size() - kSuffix.size());
    arrays[key] = std::move(*array);
  }
  return arrays;
}

}  // namespace saltus
