#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <memory>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "connection.h"
#include "convert.h"
#include "soundmap/client.h"

namespace soundmap {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kChunkBytes = 256 << 10;
constexpr std::int64_t kMaxYamlBytes = 1 << 20;

absl::Status FileError(absl::string_view verb, const std::string& path, int error) {
  const std::string message = absl::StrCat("cannot ", verb, " ", path, ": ", std::strerror(error));
  if (error == ENOENT) return absl::NotFoundError(message);
  if (error == EACCES || error == EPERM) return absl::PermissionDeniedError(message);
  if (error == ENOSPC) return absl::ResourceExhaustedError(message);
  return absl::FailedPreconditionError(message);
}

absl::StatusOr<std::int64_t> FileSize(const std::string& path) {
  std::error_code error;
  const auto status = fs::status(path, error);
  if (status.type() == fs::file_type::not_found) return FileError("read", path, ENOENT);
  if (!error && !fs::is_regular_file(status)) {
    return absl::InvalidArgumentError(absl::StrCat(path, " is not a file"));
  }
  const auto size = error ? 0 : fs::file_size(path, error);
  if (error) return FileError("read", path, error.value());
  return static_cast<std::int64_t>(size);
}

absl::StatusOr<std::string> ReadSmallFile(const std::string& path, std::int64_t max_bytes) {
  const auto size = FileSize(path);
  if (!size.ok()) return size.status();
  if (*size > max_bytes) {
    return absl::InvalidArgumentError(absl::StrCat(path, " is longer than ", max_bytes, " bytes"));
  }
  std::ifstream file(path, std::ios::binary);
  if (!file) return FileError("read", path, errno);
  return std::string(std::istreambuf_iterator<char>(file), {});
}

bool IsImageLine(absl::string_view line) {
  return absl::StartsWith(absl::StripLeadingAsciiWhitespace(line), "image:");
}

// A ROS map file names its image in one line, `image: NAME`, relative to itself.
absl::StatusOr<std::string> ImageOfYaml(const std::string& path) {
  const auto text = ReadSmallFile(path, kMaxYamlBytes);
  if (!text.ok()) return text.status();
  for (absl::string_view line : absl::StrSplit(*text, '\n')) {
    if (!IsImageLine(line)) continue;
    line = absl::StripAsciiWhitespace(line.substr(line.find(':') + 1));
    if (line.size() >= 2 && (line.front() == '"' || line.front() == '\'') &&
        line.back() == line.front()) {
      line = line.substr(1, line.size() - 2);
    }
    if (!line.empty()) return (fs::path(path).parent_path() / std::string(line)).string();
  }
  return absl::InvalidArgumentError(absl::StrCat(path, " names no image"));
}

// The format and the files to send one after the other.
struct ImportFiles {
  std::string format;
  std::vector<std::string> paths;
  std::vector<std::int64_t> sizes;
};

absl::StatusOr<ImportFiles> FindImportFiles(const std::string& path) {
  ImportFiles files;
  files.format = absl::AsciiStrToLower(fs::path(path).extension().string());
  if (!files.format.empty()) files.format.erase(0, 1);
  if (files.format == "yml") files.format = "yaml";
  static constexpr const char* kFormats[] = {"bt", "ot", "ply", "pcd", "yaml"};
  if (std::find(std::begin(kFormats), std::end(kFormats), files.format) == std::end(kFormats)) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, " is not a .bt, .ot, .ply, .pcd or .yaml file"));
  }
  files.paths = {path};
  if (files.format == "yaml") {
    auto image = ImageOfYaml(path);
    if (!image.ok()) return image.status();
    files.paths.push_back(*std::move(image));
  }
  for (const std::string& file : files.paths) {
    const auto size = FileSize(file);
    if (!size.ok()) return size.status();
    files.sizes.push_back(*size);
  }
  return files;
}

bool IsSuffix(const std::string& suffix) {
  return suffix.size() >= 2 && suffix.size() <= 8 && suffix[0] == '.' &&
         std::all_of(suffix.begin() + 1, suffix.end(), absl::ascii_isalnum);
}

// The files of one export, written beside their final names and renamed together. Unless Finish()
// is OK nothing is left.
class ExportFiles {
 public:
  ExportFiles(std::string path, const std::string& format) : path_(std::move(path)) {
    main_suffix_ = absl::StrCat(".", format);
    if (format == "yaml" && fs::path(path_).extension() != ".yaml") path_ += ".yaml";
  }
  ~ExportFiles() {
    file_.close();
    std::error_code ignored;
    for (const std::string& name : names_) fs::remove(Part(name), ignored);
  }

  absl::Status Begin(const std::string& suffix) {
    if (!IsSuffix(suffix)) {
      return absl::InternalError("the server sent a file name suffix that is none");
    }
    return Open(suffix == main_suffix_ ? path_
                                       : fs::path(path_).replace_extension(suffix).string());
  }

  absl::Status Append(const std::string& data) {
    if (names_.empty()) {
      const absl::Status status = Open(path_);
      if (!status.ok()) return status;
    }
    errno = 0;
    if (!file_.write(data.data(), static_cast<std::streamsize>(data.size()))) {
      return FileError("write", names_.back(), errno == 0 ? EIO : errno);
    }
    return absl::OkStatus();
  }

  absl::Status Finish() {
    absl::Status status = Close();
    if (status.ok() && names_.empty()) status = absl::InternalError("the server sent no file");
    if (status.ok() && main_suffix_ == ".yaml") status = NameImage();
    for (const std::string& name : names_) {
      std::error_code error;
      if (status.ok()) fs::rename(Part(name), name, error);
      if (error) status = FileError("write", name, error.value());
    }
    return status;
  }

  const std::vector<std::string>& names() const { return names_; }

 private:
  static std::string Part(const std::string& name) { return name + ".part"; }

  absl::Status Open(const std::string& name) {
    const absl::Status status = Close();
    if (!status.ok()) return status;
    if (std::find(names_.begin(), names_.end(), name) != names_.end()) {
      return absl::InternalError(absl::StrCat("the server sent ", name, " twice"));
    }
    file_.open(Part(name), std::ios::binary | std::ios::trunc);
    if (!file_) return FileError("write", name, errno);
    names_.push_back(name);
    return absl::OkStatus();
  }

  absl::Status Close() {
    if (!file_.is_open()) return absl::OkStatus();
    errno = 0;
    file_.close();
    if (file_.fail()) return FileError("write", names_.back(), errno == 0 ? EIO : errno);
    return absl::OkStatus();
  }

  // The server does not know the name that the image gets here.
  absl::Status NameImage() {
    const auto text = ReadSmallFile(Part(path_), kMaxYamlBytes);
    if (!text.ok()) return text.status();
    const auto image = std::find_if(names_.begin(), names_.end(),
                                    [this](const std::string& name) { return name != path_; });
    if (image == names_.end()) return absl::OkStatus();
    std::vector<std::string> lines = absl::StrSplit(*text, '\n');
    for (std::string& line : lines) {
      if (IsImageLine(line)) line = absl::StrCat("image: ", fs::path(*image).filename().string());
    }
    std::ofstream file(Part(path_), std::ios::binary | std::ios::trunc);
    if (!(file << absl::StrJoin(lines, "\n")) || !file.flush()) {
      return FileError("write", path_, errno);
    }
    return absl::OkStatus();
  }

  std::string path_;
  std::string main_suffix_;
  std::vector<std::string> names_;  // in the order they came
  std::ofstream file_;              // of names_.back()
};

}  // namespace

absl::StatusOr<Operation> Client::ImportMap(const std::string& site, const std::string& path,
                                            const ProgressCallback& progress) {
  const auto files = FindImportFiles(path);
  if (!files.ok()) return files.status();
  std::int64_t total = 0;
  for (const std::int64_t size : files->sizes) total += size;

  grpc::ClientContext context;
  connection_->Prepare(context, connection_->options.stream_timeout);
  v1::Operation started;
  const auto writer = connection_->maps->ImportMap(&context, &started);
  v1::ImportMapRequest message;
  message.mutable_header()->set_site(internal::SiteName(site));
  message.mutable_header()->set_format(files->format);
  if (files->format == "yaml") message.mutable_header()->set_image_offset(files->sizes[0]);
  bool open = writer->Write(message);

  Operation sending{.kind = "import_map", .site = site, .progress_text = "sending the file"};
  std::int64_t sent = 0;
  absl::Status local;
  for (std::size_t i = 0; i < files->paths.size() && open && local.ok(); ++i) {
    std::ifstream file(files->paths[i], std::ios::binary);
    if (!file) local = FileError("read", files->paths[i], errno);
    for (std::int64_t left = files->sizes[i]; left > 0 && open && local.ok();) {
      std::string& data = *message.mutable_data();
      data.resize(std::min<std::size_t>(kChunkBytes, static_cast<std::size_t>(left)));
      if (!file.read(data.data(), static_cast<std::streamsize>(data.size()))) {
        local =
            absl::DataLossError(absl::StrCat(files->paths[i], " became shorter while it was read"));
        break;
      }
      left -= static_cast<std::int64_t>(data.size());
      sent += static_cast<std::int64_t>(data.size());
      open = writer->Write(message);
      sending.progress = static_cast<double>(sent) / static_cast<double>(total);
      if (progress && !progress(sending)) local = absl::CancelledError("the import was cancelled");
    }
  }
  if (local.ok()) {
    writer->WritesDone();
  } else {
    context.TryCancel();
  }
  const grpc::Status status = writer->Finish();
  if (!local.ok()) return local;
  if (!status.ok()) return connection_->Error(status);
  return WaitOperation(started.name(), progress);
}

absl::StatusOr<ExportedMap> Client::ExportMap(const ExportMapRequest& request,
                                              const std::string& path,
                                              const BytesCallback& progress) {
  v1::ExportMapRequest wire;
  wire.set_site(internal::SiteName(request.site));
  wire.set_what(internal::ToProto(request.what));
  wire.set_format(request.format);
  wire.set_full(request.full);
  wire.set_min_updates(request.min_updates);
  wire.set_band(request.band);
  ExportedMap exported;
  ExportFiles files(path, request.format);
  absl::Status local;
  const absl::Status status = connection_->Stream<v1::ExportMapResponse>(
      *connection_->maps, &v1::MapService::Stub::ExportMap, wire,
      [&](const v1::ExportMapResponse& chunk) {
        if (chunk.revision() != 0) exported.revision = chunk.revision();
        if (chunk.as_of_ns() != 0) exported.as_of_ns = chunk.as_of_ns();
        if (!chunk.file_suffix().empty()) local = files.Begin(chunk.file_suffix());
        if (local.ok()) local = files.Append(chunk.data());
        exported.bytes += static_cast<std::int64_t>(chunk.data().size());
        if (local.ok() && progress && !progress(exported.bytes)) {
          local = absl::CancelledError("the export was cancelled");
        }
        return local.ok();
      });
  if (!local.ok()) return local;
  if (!status.ok()) return status;
  const absl::Status finished = files.Finish();
  if (!finished.ok()) return finished;
  exported.files = files.names();
  return exported;
}

}  // namespace soundmap
