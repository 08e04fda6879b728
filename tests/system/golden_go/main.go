// Reads the golden messages of the contract with Go's protobuf. The content of each line must give its bytes, in any order
// of fields, which protobuf leaves open, and the bytes must give its content. Prints the number of lines; exits with code 1
// and a message if a line does not agree.
package main

import (
	"bufio"
	"bytes"
	"encoding/hex"
	"fmt"
	"os"
	"sort"
	"strings"

	"google.golang.org/protobuf/encoding/prototext"
	"google.golang.org/protobuf/encoding/protowire"
	"google.golang.org/protobuf/proto"
	"google.golang.org/protobuf/reflect/protoreflect"
	"google.golang.org/protobuf/reflect/protoregistry"

	_ "motiongen/v1"
)

// ordered returns an encoded message, and those within it, with fields sorted by number; equal numbers keep their order.
func ordered(encoded []byte, kind protoreflect.MessageDescriptor) ([]byte, error) {
	type field struct {
		number protowire.Number
		bytes  []byte
	}
	var fields []field
	for len(encoded) > 0 {
		number, wire, tagLength := protowire.ConsumeTag(encoded)
		if tagLength < 0 {
			return nil, protowire.ParseError(tagLength)
		}
		length := protowire.ConsumeFieldValue(number, wire, encoded[tagLength:])
		if length < 0 {
			return nil, protowire.ParseError(length)
		}
		written := encoded[:tagLength+length]
		known := kind.Fields().ByNumber(number)
		if known != nil && known.Message() != nil {
			content, _ := protowire.ConsumeBytes(encoded[tagLength:])
			inner, err := ordered(content, known.Message())
			if err != nil {
				return nil, err
			}
			written = protowire.AppendBytes(protowire.AppendTag(nil, number, wire), inner)
		}
		fields = append(fields, field{number, written})
		encoded = encoded[tagLength+length:]
	}
	sort.SliceStable(fields, func(one, other int) bool { return fields[one].number < fields[other].number })
	var joined []byte
	for _, each := range fields {
		joined = append(joined, each.bytes...)
	}
	return joined, nil
}

// check compares one line: name of the message, content in text format, bytes in hexadecimal.
func check(line string) error {
	parts := strings.Split(line, "\t")
	if len(parts) != 3 {
		return fmt.Errorf("a line has %d parts, not 3", len(parts))
	}
	kind, err := protoregistry.GlobalTypes.FindMessageByName(protoreflect.FullName("motiongen.v1." + parts[0]))
	if err != nil {
		return err
	}
	content, read := kind.New().Interface(), kind.New().Interface()
	if err := prototext.Unmarshal([]byte(parts[1]), content); err != nil {
		return err
	}
	encoded, err := hex.DecodeString(parts[2])
	if err != nil {
		return err
	}
	if err := proto.Unmarshal(encoded, read); err != nil {
		return err
	}
	if !proto.Equal(content, read) {
		return fmt.Errorf("%s is read as %s", parts[0], prototext.Format(read))
	}
	if len(read.ProtoReflect().GetUnknown()) > 0 {
		return fmt.Errorf("%s has fields that the contract does not know", parts[0])
	}
	written, err := proto.MarshalOptions{Deterministic: true}.Marshal(content)
	if err != nil {
		return err
	}
	inOrder, err := ordered(written, kind.Descriptor())
	if err != nil {
		return err
	}
	if !bytes.Equal(inOrder, encoded) {
		return fmt.Errorf("%s is written as %x, not %x", parts[0], written, encoded)
	}
	return nil
}

func main() {
	lines := bufio.NewScanner(os.Stdin)
	lines.Buffer(nil, 1<<20)
	count := 0
	for lines.Scan() {
		count++
		if err := check(lines.Text()); err != nil {
			fmt.Fprintf(os.Stderr, "line %d: %v\n", count, err)
			os.Exit(1)
		}
	}
	if err := lines.Err(); err != nil {
		fmt.Fprintln(os.Stderr, err)
		os.Exit(1)
	}
	fmt.Println(count)
}
